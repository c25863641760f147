"""What `handcal lab size --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Floats, Kind, Texts, Vector, Version
from handcal.results.parts import CalibrationFit, Level, Parameter, Recording


class Size(TypedDict):
    """Where the three accelerometers sit."""

    schema: Kind[Literal["handcal/calibration/1"]]
    version: NotRequired[Version]
    method: Annotated[str, (("pattern", "^size-effect from "),), "From what it was found."]
    recording: Annotated[Recording | _SizeRecording, "Of a table of tests its path alone."]
    parameters: list[Parameter]
    covariance: Annotated[list[Floats], "Of the parameters, in their order."]
    noise: Annotated[list[Level], "Empty."]
    fit: CalibrationFit
    mounting: Annotated[list[Parameter], "How the IMU sits on the table."]
    mean_place: _MeanPlace
    residual_rms: Annotated[_ResidualRms, "Of the readings while it turns."]
    warnings: Annotated[Texts, "In sentences."]


class _SizeRecording(TypedDict):
    path: Annotated[str, "Of the table."]


class _MeanPlace(TypedDict):
    value: Vector
    sigma: Vector
    unit: Literal["m"]


class _ResidualRms(TypedDict):
    before: Vector
    after: Vector
    unit: Literal["m/s^2"]
