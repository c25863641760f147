"""What `handcal calibrate --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Empty, Kind, Later, Number, Texts, Version
from handcal.results.known import KnownDevice, KnownModel, OwnLikelihood
from handcal.results.model import Model
from handcal.results.parts import (
    CalibrationFit,
    Level,
    MarkerRotation,
    Parameter,
    Quality,
    Recording,
    Untellable,
)


class Calibration(TypedDict):
    """The sensor errors of a recording, or of several of one device together."""

    schema: Kind[Literal["handcal/calibration/1"]]
    version: NotRequired[Version]
    trust: Later[
        Annotated[
            Literal["good", "doubtful", "none"],
            "Of the numbers; `none`: the fit leaves what no hand makes.",
        ]
    ]
    trust_reasons: Later[Annotated[Texts, "Why it is not `good`."]]
    recording: NotRequired[Annotated[Recording, "", "of one recording"]]
    parameters: Annotated[
        list[Parameter], "Of several recordings those that they share, jointly estimated."
    ]
    noise: list[Level]
    fit: CalibrationFit
    untellable: Later[Annotated[list[Untellable], "What this motion cannot show."]]
    model: Later[Annotated[Model | Empty, "Empty where there is none."]]
    recordings: NotRequired[
        Annotated[list[OneCalibration], "What each has of its own.", "with several recordings"]
    ]
    covariance: Later[
        Annotated[
            list[list[Number]],
            "Of the parameters, in their order and units; null what is not known.",
        ]
    ]
    marker_rotation: NotRequired[Annotated[MarkerRotation, "", "with a `/pose`, of one recording"]]
    likelihood: NotRequired[OwnLikelihood]
    quality: NotRequired[Annotated[Quality, "", "of one recording"]]
    device: NotRequired[Annotated[KnownDevice, "", "with `--device`"]]
    priors: NotRequired[Annotated[KnownModel, "", "with `--priors`"]]
    warnings: Annotated[Texts, "In sentences."]


class OneCalibration(TypedDict):
    """One recording of several."""

    schema: Literal["handcal/calibration/1"]
    recording: Recording
    parameters: Annotated[list[Parameter], "Its own: the biases."]
    noise: list[Level]
    fit: CalibrationFit
    untellable: Later[list[Untellable]]
    covariance: Later[Annotated[list[list[Number]], "Of its own parameters."]]
    marker_rotation: NotRequired[Annotated[MarkerRotation, "", "with a `/pose`"]]
    quality: NotRequired[Annotated[Quality, "", "where all its numbers are known"]]
    warnings: Annotated[Texts, "In sentences."]
