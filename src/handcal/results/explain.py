"""What `handcal explain --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Empty, Floats, Kind, Later, Number, Some, Texts, Version
from handcal.results.known import KnownDevice, KnownModel, OwnLikelihood
from handcal.results.model import Model
from handcal.results.parts import Level, MarkerRotation, Parameter, Quality, Recording, Untellable


class Explanation(TypedDict):
    """What the recordings hold that biases do not account for."""

    schema: Kind[Literal["handcal/explanation/1"]]
    version: NotRequired[Version]
    verdict: Annotated[
        Literal["nothing_missing", "explained", "unexplained", "cannot_tell"],
        "`explained`: named effects account for the mismatch; `unexplained`: something is left "
        "that no known effect accounts for; `cannot_tell`: effects fit equally well and this "
        "motion does not separate them, or the search ended before all was tried (`untried`).",
    ]
    trust: Later[
        Annotated[
            Literal["good", "doubtful", "none"],
            "Of the final fit's numbers; `none`: it leaves residuals that no hand makes.",
        ]
    ]
    trust_reasons: Later[Annotated[Texts, "Why it is not `good`."]]
    mismatch: Annotated[list[Mismatch], "Where the baseline does not fit."]
    missing: Annotated[list[Missing], "What was found, the largest share first."]
    hand: Later[Annotated[_Hand, "What the hand does."]]
    unnamed: Annotated[list[Unnamed], "Empty unless the verdict is `unexplained`."]
    hypotheses: Later[Annotated[list[Hypothesis], "Every effect that was tried."]]
    fit: _Fit
    held_out: Annotated[HeldOut | Empty, "Empty where nothing was held out."]
    next_motion: Annotated[list[NextMotion], "What to record next."]
    parameters: Annotated[
        list[Parameter], "Of the final model; of several recordings those that they share."
    ]
    noise: Annotated[list[Level], "Of the final model."]
    untellable: Later[Annotated[list[Untellable], "What this recording cannot show."]]
    model: Later[Annotated[Model | Empty, "Empty where there is none."]]
    covariance: NotRequired[
        Annotated[
            list[list[Number]],
            "Of the parameters, in their order and units; null what is not known.",
            "where all of them are of one fit",
        ]
    ]
    marker_rotation: NotRequired[Annotated[MarkerRotation, "", "with a `/pose`, of one recording"]]
    likelihood: NotRequired[OwnLikelihood]
    quality: NotRequired[Annotated[Quality, "", "of one recording"]]
    device: NotRequired[Annotated[KnownDevice, "", "with `--device`"]]
    priors: NotRequired[Annotated[KnownModel, "", "with `--priors`"]]
    warnings: Annotated[Texts, "In sentences."]
    untried: NotRequired[
        Annotated[Some[str], "What was left out, in words.", "if `--budget` ended the search"]
    ]
    recordings: NotRequired[Annotated[list[OneRecording], "", "with several recordings"]]
    recording: NotRequired[Annotated[Recording, "", "of one recording"]]


class Mismatch(TypedDict):
    """A stretch of a channel that the baseline does not fit."""

    channel: Annotated[
        str,
        "`gyro_x`, `accel_y`, `heading`, `mag_z`, `position_x`, `velocity_x`, `attitude_x`, ...",
    ]
    from_s: Annotated[Number, "Begin."]
    to_s: Annotated[Number, "End."]
    share: Annotated[Number, "Of the total shortfall in log score."]
    when: Annotated[str, "In words, `turning faster than 90 deg/s`."]
    recording: NotRequired[Annotated[Count, "Which, from 0.", "with several recordings"]]


class Missing(TypedDict):
    """An effect that is present, or the most probable of a set that this recording cannot
    separate."""

    effect: Annotated[str, "Id."]
    probability: Annotated[Number, "That it, or its set, is present; over one half."]
    log_evidence_gain: Annotated[Number, "Nats: the final model against the same without it."]
    indistinguishable_from: Annotated[Texts, "The others of its set, by probability."]
    parameters: Annotated[list[Value], "Its constants."]
    story: Annotated[str, "In plain words."]
    size: Later[
        Annotated[
            dict[str, float], "By channel: root mean square of what it does to the readings, SI."
        ]
    ]
    share: Later[Annotated[Number, "Of the whole mismatch."]]
    held_out_gain: Later[
        Annotated[
            Number,
            "Nats on data not seen, with it against without it; null where those would not tell.",
        ]
    ]


class Value(TypedDict):
    """A constant with its uncertainty."""

    name: Annotated[str, "Of the parameter."]
    value: Annotated[Number, "In its unit."]
    sigma: Annotated[Number, "Standard deviation."]
    unit: Annotated[str, "SI."]


class _Hand(TypedDict):
    id: str
    probability: Number


class Unnamed(TypedDict):
    """A law that the catalogue has not."""

    formula: Annotated[str, "`accel_x += k * omega_y * T`"]
    value: Annotated[Number, "Of its constant."]
    sigma: Annotated[Number, "Of that."]
    unit: Annotated[str, "SI."]
    log_evidence_gain: Annotated[Number, "Nats."]
    story: Later[Annotated[str, "The same in words, where the formula is a course; else empty."]]
    channels: Later[Annotated[Texts, "To which it adds."]]
    drivers: Later[Annotated[Texts, "What drives it."]]
    constants: Later[Annotated[list[Value], "All of them."]]
    curve: Later[Annotated[Curve | Empty, "Empty where there is none to draw."]]


class Curve(TypedDict):
    """What a law adds over what drives it."""

    x: Annotated[Floats, "Driver."]
    y: Annotated[Floats, "What is read too much."]
    sigma: Annotated[Floats, "Of y."]
    x_unit: Annotated[str, "SI."]
    y_unit: Annotated[str, "SI."]


class Hypothesis(TypedDict):
    """One effect on trial."""

    effect: Annotated[str, "Id."]
    alone: Annotated[Number, "Nats over the baseline."]
    final: Annotated[Number, "Nats in the final model, or added to it."]
    expected_gain: Annotated[Number, "Nats that one of the usual size would gain."]
    probability: Annotated[Number, "That it is present."]


class _Fit(TypedDict):
    before: Annotated[ExplanationFit, "The baseline."]
    after: Annotated[ExplanationFit, "With what was found."]


class ExplanationFit(TypedDict):
    """How well a model fits."""

    log_evidence: Annotated[Number, "Natural log."]
    residual_rms: Annotated[dict[str, float], "By channel, SI."]
    nis: Annotated[dict[str, float], "By kind of observation; 1 is expected."]
    whiteness: Annotated[dict[str, float], "By kind; 0 is right."]


class HeldOut(TypedDict):
    """Predicted without having been seen: `--held-out`, else later blocks from earlier ones."""

    log_score_before: Annotated[Number, "Nats; higher is better."]
    log_score_after: Annotated[Number, "With what was found."]
    residual_rms_before: Annotated[dict[str, float], "By channel, SI."]
    residual_rms_after: Annotated[dict[str, float], "By channel, SI."]


class NextMotion(TypedDict):
    """What to record next."""

    motion: Annotated[str, "What to do."]
    separates: Annotated[Texts, "Ids that it tells apart."]
    expected_gain: Annotated[Number, "Nats."]


class OneRecording(TypedDict):
    """One recording of several."""

    recording: Recording
    parameters: Annotated[list[Parameter], "Its own."]
    marker_rotation: NotRequired[Annotated[MarkerRotation, "", "with a `/pose`"]]
    noise: list[Level]
