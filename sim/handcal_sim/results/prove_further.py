"""What single suites of `handcal prove` have in their score."""

from __future__ import annotations

from typing import Annotated, Any, NotRequired, TypedDict

from handcal.results.kinds import Count, Number, Texts
from handcal_sim.results.parts import Share


class Covered(TypedDict):
    """How far estimates are off, in their sigmas."""

    within_1_sigma: Share
    within_3_sigma: Share
    rms: Annotated[Number, "Of the deviations."]


class _Further(TypedDict):
    phone: NotRequired[Annotated[_Phone, "", "of that suite"]]
    odometry: NotRequired[Annotated[_Odometry, "", "of that suite"]]
    people: NotRequired[Annotated[_People, "", "of that suite"]]
    budget: NotRequired[Annotated[_Budget, "", "of that suite"]]
    strange: NotRequired[Annotated[Laws, "", "of that suite"]]
    latest: NotRequired[Annotated[Laws, "", "of that suite"]]
    ordinary: NotRequired[Annotated[_Ordinary, "", "of that suite"]]


class _Phone(TypedDict):
    parameters: Annotated[dict[str, Covered], "By effect, and `all`."]
    asked: _Asked
    impossible: Share


class _Asked(TypedDict):
    target: float
    met: bool | None


class _Odometry(TypedDict):
    perfect_said_to_drift: Share
    drift_found: Share
    parameters: Annotated[dict[str, Covered], "By effect, and `all`."]


class _People(TypedDict):
    doings: dict[str, _Doings]
    verdicts: dict[str, Count]


class _Doings(TypedDict):
    n: Count
    false: Count
    named: dict[str, Count]


class _Budget(TypedDict):
    left: _Left
    names: Share
    parameters: Annotated[dict[str, Covered], "By effect, and `all`."]


class _Left(TypedDict):
    n: Count
    median: Number
    worst: Number
    told: Annotated[
        _LeftTold,
        "The same where `calibrate` is told all names, asked of those of which more is left than "
        "the median that is asked.",
    ]
    beyond: Annotated[
        Count,
        "Recordings of which more is left than is asked of the worst, and more than is "
        "unavoidable.",
    ]
    asked: _LeftAsked
    met: bool


class _LeftTold(TypedDict):
    median: Number
    worst: Number


class _LeftAsked(TypedDict):
    median: float
    worst: float
    beside_told: float


class Laws(TypedDict):
    """Laws without a name that were hidden, and what became of them."""

    laws: list[Law]
    told: Share
    driver: Share
    clean: Share
    false: Share
    little_left: Share
    nothing_left: Share
    nothing_left_if_told: Share
    nothing_left_if_form: Share
    truth_is_likelier: Annotated[
        Share,
        "Of recordings of which a driver is not told: in how many the laws themselves, with the "
        "true names, make the recording more probable than the explanation.",
    ]


class Law(TypedDict):
    """A law from outside the catalogue, and what was said of it."""

    recording: str
    law: str
    channels: Texts
    drivers: list[Any]
    formula: Annotated[Any, "Of the law."]
    k: Annotated[Any, "Its constants."]
    verdict: str
    channel: Annotated[bool, "Told on the right channels."]
    driver: Annotated[bool, "With the right drivers."]
    false: Annotated[Texts, "Names that are not there."]
    found: Annotated[Texts, "Formulas."]
    left: Annotated[Number, "Share of the law that is left."]
    told: Annotated[
        Number,
        "The same where `calibrate` is told the law and all names, and has but their sizes to "
        "find; asked where more is left than a hundredth, and not of a heading.",
    ]
    form: Annotated[
        Number,
        "The same where `calibrate` is told the law but for its numbers, of each of which it "
        "knows but the range: they are found to the first order about what they are.",
    ]
    truth: Annotated[
        Number,
        "Nats by which the laws themselves, with the true names, make the recording more probable "
        "than the explanation; asked where `told` is, of a held hand.",
    ]


class _Ordinary(TypedDict):
    coverage: Annotated[
        dict[str, Numbers],
        "Of all parameters that were drawn, and of parts of them; `absent`: of effects that are "
        "not there.",
    ]
    numbers_asked: list[_NumbersAsked]
    found: Share
    rare_found: Share
    false_rare: Share
    names_asked: dict[str, _NamesAsked]
    not_found: dict[str, Count]
    false_names: dict[str, Count]


class Numbers(TypedDict):
    """How many parameters are within one sigma and two of the truth."""

    within_1_sigma: Share
    within_2_sigma: Share
    rms: Annotated[Number, "Of what they are off, in sigmas."]
    shown: Annotated[Count, "How many of them the recordings showed."]
    sigma_over_spread: Annotated[
        Number, "Median of the sigmas over the spreads of the devices' classes."
    ]


class _NumbersAsked(TypedDict):
    part: Annotated[str, "Of `coverage`."]
    sigmas: int
    asked: Annotated[float, "Share within so many sigmas."]
    off: Annotated[Number, "How far it may be from that; null: it may be more."]
    measured: Share
    met: bool | None


class _NamesAsked(TypedDict):
    asked: float
    met: bool | None
