"""What `handcal allan --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Floats, Kind, Later, Six, Texts, Two, Version
from handcal.results.parts import Level


class Allan(TypedDict):
    """Noise of a device at rest."""

    schema: Kind[Literal["handcal/allan/1"]]
    version: NotRequired[Version]
    recording: _AllanRecording
    span_s: Annotated[Two[float], "The stretch that was used."]
    channels: Six[_Channel]
    suggested: Annotated[list[Level], "Levels for the filter."]
    not_seen: Annotated[Texts, "What the record is too short for, in sentences."]
    warnings: Annotated[Texts, "In sentences."]


class _AllanRecording(TypedDict):
    path: str
    duration_s: float
    imu_rate_hz: float
    streams: Later[Annotated[_Streams, "With the topic, where it was read from a bag."]]
    sha256: Later[Annotated[str | None, "Of the recording's file."]]


class _Streams(TypedDict):
    imu: _Imu


class _Imu(TypedDict):
    samples: int
    topic: NotRequired[Annotated[str, "", "of a bag"]]


class _Channel(TypedDict):
    channel: Literal["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    unit: Annotated[str, "Of the deviation."]
    tau_s: Annotated[Floats, "Averaging times."]
    deviation: Annotated[Floats, "Overlapping Allan deviation."]
    low: Annotated[Floats, "Of the 95 % band."]
    high: Annotated[Floats, "Of the 95 % band."]
    edf: Annotated[Floats, "Degrees of freedom."]
    fit_from_s: Annotated[float, "Shorter averaging times were left out of the fit."]
    coefficients: Annotated[list[_Coefficient], "What was seen."]
    not_seen: Annotated[list[_NotSeen], "What was not."]


class _Coefficient(TypedDict):
    name: Annotated[
        Literal["Q", "N", "B", "K", "R"],
        "Q quantisation, N white noise, B bias instability, K random walk, R ramp.",
    ]
    value: float
    sigma: Annotated[float, "Standard deviation."]
    unit: str


class _NotSeen(TypedDict):
    name: Literal["Q", "N", "B", "K", "R"]
    at_most: Annotated[float, "95 %."]
    unit: str
