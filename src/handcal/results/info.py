"""What `handcal info --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Floats, Kind, Later, Texts, Vector, Version


class Info(TypedDict):
    """What a file holds, and which errors it can show."""

    schema: Kind[Literal["handcal/info/1"]]
    version: NotRequired[Version]
    recording: _InfoRecording
    units: _Units
    streams: list[_InfoStream]
    range: _Range
    rests: list[_Rest]
    rests_show: Later[str]
    turns: list[_Turn]
    could_teach: list[_CouldTeach]
    warnings: Annotated[Texts, "In sentences."]


class _InfoRecording(TypedDict):
    path: str
    duration_s: float
    start_ns: Annotated[int, "Of the first reading, on the recording's own clock."]
    format: Annotated[str, "By which it was read."]


class _Units(TypedDict):
    stated: Annotated[str, "By the file."]
    evidence: Annotated[Texts, "Why they are believed."]
    gravity_read: Annotated[float, "m/s^2, where stillest."]
    turning_error_rad: Annotated[
        Floats,
        "By how much the gyro misses the turns of gravity: as read, and were its rates 57 times "
        "smaller or larger; empty where little turns.",
    ]


class _InfoStream(TypedDict):
    stream: str
    topic: NotRequired[
        Annotated[str, "Where it was read.", "of a bag or a log of PX4 or ArduPilot"]
    ]
    columns: Texts
    unit: str
    readings: Count
    rate_hz: float
    jitter_s: Annotated[float, "Standard deviation of the steps."]
    first_s: float
    last_s: float
    gaps: _Gaps


class _Gaps(TypedDict):
    count: Count
    longest_s: float
    at_s: Annotated[float, "Where the longest begins."]


class _Range(TypedDict):
    largest: Annotated[dict[str, float], "By channel, SI."]
    not_trusted: Annotated[Count, "Readings."]


class _Rest(TypedDict):
    from_s: float
    to_s: float
    still: Annotated[bool, "As on a table."]
    force: Annotated[Vector, "Mean, m/s^2."]
    gyro_noise: float
    accel_noise: float


class _Turn(TypedDict):
    axis: Literal["x", "y", "z"]
    forward_rad: float
    backward_rad: float
    fastest_rad_s: float


class _CouldTeach(TypedDict):
    effect: Annotated[str, "Id."]
    shown: Annotated[Texts, "Parameters that these rests and turns show."]
    parameters: list[_Reachable]
    motion: Annotated[str, "What shows it."]


class _Reachable(TypedDict):
    name: str
    sigma: Annotated[float, "That could be reached."]
    prior_sigma: float
    unit: str
    observable: bool
