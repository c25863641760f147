"""What `handcal lab known-input --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Floats, Kind, Number, Six, Texts, Vector, Version
from handcal.results.parts import CalibrationFit, Level, Parameter, Recording, _Expected


class KnownInput(TypedDict):
    """A calibration against a turntable, a dividing head or a trusted IMU."""

    schema: Kind[Literal["handcal/calibration/1"]]
    version: NotRequired[Version]
    method: Literal["known-input"]
    axes: Annotated[Literal["imu", "table"], "In which the parameters are."]
    recording: Recording
    parameters: list[Parameter]
    mounting: Annotated[list[Parameter], "How the IMU sits on the table."]
    covariance_of: Annotated[Texts, "Rows of the covariance."]
    covariance: list[Floats]
    noise: Annotated[list[Level], "Beyond the readings' own."]
    fit: CalibrationFit
    condition: Annotated[float, "Condition number; 1 is the best."]
    kalman_difference: Annotated[float, "Kalman filter less least squares, in usual sizes."]
    tests: Annotated[list[_Tests], "Gyro rad/s, accelerometer m/s^2."]
    table_errors: Annotated[
        list[_Expected] | None, "What errors of the table bring; null where none were stated."
    ]
    better_rates: Annotated[
        list[Vector] | None, "Ten tests that tell more, rad/s; null where these are good."
    ]
    warnings: Annotated[Texts, "In sentences."]


class _Tests(TypedDict):
    reading: Six[Number]
    residual_before: Six[Number]
    residual_after: Six[Number]
