"""What `handcal lab scalar --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Floats, Kind, Texts, Version
from handcal.results.parts import CalibrationFit, Level, Parameter, Recording


class Scalar(TypedDict):
    """A calibration against the size of gravity; `handcal apply` and `export` take it as they take
    that of `calibrate`."""

    schema: Kind[Literal["handcal/calibration/1"]]
    version: NotRequired[Version]
    method: Literal["gravity-norm"]
    recording: Recording
    parameters: list[Parameter]
    covariance: Annotated[list[Floats], "Of the parameters, in their order."]
    noise: Annotated[list[Level], "Beyond the readings' own."]
    fit: CalibrationFit
    gravity: Annotated[float, "m/s^2"]
    rests: list[_ScalarRest]
    turns: list[_ScalarTurn]
    halves: Annotated[
        list[_Halves], "From the first half of the rests and the second; empty with few."
    ]
    warnings: Annotated[Texts, "In sentences."]


class _ScalarRest(TypedDict):
    from_s: float
    to_s: float
    samples: Count
    norm_error_before: Annotated[float, "m/s^2"]
    norm_error_after: Annotated[float, "m/s^2"]


class _ScalarTurn(TypedDict):
    from_rest: Count
    to_rest: Count
    seconds: float
    miss_before: Annotated[float, "rad"]
    miss_after: Annotated[float, "rad"]


class _Halves(TypedDict):
    effect: str
    name: str
    first: float
    second: float
    sigma: Annotated[float, "Of the difference."]
    unit: str
