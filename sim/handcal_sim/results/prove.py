"""What `handcal prove` writes: the score of a blind trial, and what was hidden."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Kind, Number, Texts, Two
from handcal_sim.results.parts import Share
from handcal_sim.results.prove_further import Covered, _Further


class Answers(TypedDict):
    """What was hidden, `answers.json`; written after the last explanation."""

    schema: Kind[Literal["handcal-sim/answers/1"]]
    seed: Count
    recordings: Annotated[dict[str, Answer], "By name."]


class Answer(TypedDict):
    """What is right of a recording."""

    suite: Annotated[str, "Of the trial."]
    group: Annotated[str, "Within the suite."]
    effects: Annotated[dict[str, dict[str, float]], "Injected: by effect and parameter, SI."]
    stranger: Annotated[dict[str, Any], "What no catalogue names; empty where there is none."]
    baseline: Annotated[dict[str, dict[str, float]], "True biases."]
    circumstances: Annotated[dict[str, Any], "All else that was drawn."]
    comparable: Annotated[
        dict[str, dict[str, float]], "Effects in the frame that an estimate can have."
    ]


class Proof(TypedDict):
    """The score of a blind trial."""

    schema: Kind[Literal["handcal-sim/proof/1"]]
    seed: Count
    suites: list[Suite]
    effects: Annotated[dict[str, _ProofEffect], "By truth."]
    unknown: Annotated[
        dict[str, dict[str, Count]], "By kind of unknown physics: n, unexplained, channel, formula."
    ]
    coverage: _Coverage
    probabilities: list[_Probabilities]
    held_out: _ProofHeldOut
    further: Annotated[_Further, "By suite, what it asks for beyond names."]
    against: NotRequired[
        Annotated[
            dict[str, Any],
            "The score of the other program's explanations, with the same keys.",
            "with `--against`",
        ]
    ]
    paired: NotRequired[
        Annotated[
            list[_Paired],
            "By suite: how many both programs got right, one alone, or neither.",
            "with `--against`",
        ]
    ]
    seconds: _Seconds
    recordings: list[TrialLine]


class Suite(TypedDict):
    """One suite of a trial, or a group in it."""

    suite: str
    group: Annotated[str, "Empty for the whole."]
    title: str
    n: Count
    outcomes: Annotated[dict[str, Count], "How many of each."]
    right: Share
    target: Annotated[Number, "Share that is asked for."]
    met: Annotated[bool | None, "Null where none is."]
    mean_set_size: Number


class _ProofEffect(TypedDict):
    n: Annotated[Count, "Times that it was there."]
    named: Annotated[Count, "First."]
    in_set: Annotated[Count, "Among others."]
    instead: Annotated[dict[str, Count], "What else was named."]


class _Coverage(TypedDict):
    effects: Annotated[dict[str, Covered], "By effect, and `all`."]
    baseline: Covered


_From = TypedDict("_From", {"from": float})


class _Probabilities(_From):
    to: float
    claimed: Annotated[Number, "Mean."]
    n: Count
    count: Count
    share: Number
    interval: Two[float]


class _ProofHeldOut(TypedDict):
    gained: Share
    median: Annotated[Number, "nats"]


class _Paired(TypedDict):
    suite: str
    both: Count
    this_alone: Count
    other_alone: Count
    neither: Count
    chance: Annotated[
        float, "Of a division of those as uneven as this, if neither is better (McNemar)."
    ]


class _Seconds(TypedDict):
    median: Number
    p90: Number
    most: Number


class TrialLine(TypedDict):
    """One recording of a trial."""

    recording: Annotated[str, "Name."]
    suite: str
    group: str
    outcome: Literal[
        "exact", "right_set", "too_faint", "missed", "false", "wrong", "unexplained", "failed"
    ]
    truth: Texts
    verdict: Annotated[str, "Of `explain`, or `failed`."]
    named: Annotated[list[Texts], "The sets."]
    unnamed: Annotated[Texts, "Formulas."]
    expected: Annotated[dict[str, float], "Nats that what was not named promised."]
    further: Annotated[dict[str, Number], "What only the simulator knows."]
    seconds: float
    error: NotRequired[Annotated[str, "What happened.", "if it failed"]]
