"""The model in a result, by which a fit is repeated."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Floats, Texts


class Model(TypedDict):
    """What `--from` needs to repeat the fit; for the program, not for people."""

    effects: Annotated[list[ModelEffect], "In the order in which they act."]
    noise_effects: Annotated[Texts, "Ids."]
    recordings: Annotated[list[View], "One for each."]
    options: Annotated[_Options, "As given."]
    begin: NotRequired[
        Annotated[
            Literal["baseline", "online"],
            "The trajectory to start from.",
            "where one is the better",
        ]
    ]
    levels: Annotated[
        list[dict[str, float]], "Noise levels to start from, by name; of each recording."
    ]


class ModelEffect(TypedDict):
    """An effect of the model."""

    id: Annotated[str, "Of the effect, or the formula of a law."]
    start: NotRequired[
        Annotated[dict[str, float], "By parameter: where the fit begins.", "where it is not zero"]
    ]
    last: NotRequired[
        Annotated[bool, "False: before others that change what it acts on.", "if false"]
    ]
    moment: NotRequired[Annotated[_Moment, "", "of what happens at a moment"]]
    made: NotRequired[Annotated[_Made, "", "of a law without a name"]]
    prior: NotRequired[
        Annotated[float, "Usual size of a law's constant.", "of a law with a formula"]
    ]


class _Moment(TypedDict):
    at: Annotated[float, "s"]
    sigma: Annotated[float, "s"]


class _Made(TypedDict):
    kind: Annotated[str, "Of law."]
    numbers: Annotated[list[Any], "That make it up."]


class View(TypedDict):
    """How the model looks at a recording."""

    samples: Annotated[Count, "Readings of its IMU."]
    observations: Annotated[Texts, "Kinds, in their order."]
    assume: Annotated[str, "As in `recording`."]
    hand: Annotated[Literal["held", "creeping", "resting"], "What the hand does."]
    left_out: list[LeftOut]
    warnings: Annotated[Texts, "What was remarked."]


class LeftOut(TypedDict):
    """Readings that were taken for wrong."""

    observation: Annotated[str, "Kind."]
    rows: Annotated[list[Count], "Which of its readings."]
    log_evidence: Annotated[float, "What their being wrong costs, nats."]
    shifted: NotRequired[
        Annotated[
            Floats, "Since when they are off, and by how much.", "where they are off together"
        ]
    ]


class _Options(TypedDict):
    height: Annotated[float, "m"]
    noise: Annotated[dict[str, float], "Known noise levels, SI, by name."]
    ignore: Annotated[Texts, "Streams."]
    reference_exact: Annotated[bool, "`--reference-exact`"]
    latitude: NotRequired[Annotated[float, "rad", "where it was given"]]
