"""What ``explain`` found, as frozen dataclasses: report, dashboard and JSON read only these."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from handcal.estimate.specification import Specification
from handcal.types import (
    Array,
    Brief,
    Likelihood,
    MarkerRotation,
    NoiseLevel,
    Parameter,
    Prior,
    Recording,
)

VERDICTS = ("nothing_missing", "explained", "unexplained", "cannot_tell")


@dataclass(frozen=True, repr=False)
class Mismatch(Brief):
    """Where the baseline falls short: share of the whole shortfall in log score, and when.

    recording: which of the explanation's recordings the times are of.
    """

    channel: str
    from_s: float
    to_s: float
    share: float
    when: str
    recording: int = 0


@dataclass(frozen=True)
class Missing:
    """One effect that is present (or one set of effects of which one is).

    probability: posterior that it (or its set) is present; log_evidence_gain: final model
    against the same without it, nats; indistinguishable_from: the others of its set, most
    probable first; title, story, motion: from the catalogue, plain words. size: root mean square
    of what it adds to each channel's readings, SI; share: of all that the final model gains, what
    is lost without it alone; held_out_gain: nats on unseen data with it against without it, None
    where those would not tell.
    """

    effect: str
    title: str
    probability: float
    log_evidence_gain: float
    indistinguishable_from: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    story: str
    motion: str
    size: Mapping[str, float] = field(default_factory=dict)
    share: float = 0.0
    held_out_gain: float | None = None


@dataclass(frozen=True, repr=False)
class Curve(Brief):
    """What a term adds, y (k,), with one sigma (k,), over what drives it, x (k,); units. behind
    (m, 2): means of the driver, and of what was read beyond a fit without the term."""

    x: Array
    y: Array
    sigma: Array
    x_unit: str
    y_unit: str
    behind: Array = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(frozen=True)
class Unnamed:
    """A term found outside the catalogue, as a formula of measured signals; story: the same in
    words, where the formula is a course over time or direction. channels: to which it adds;
    drivers: the signals in it; curve: what it adds in the first recording; constants: all of a
    formula's, none of a curve's; where there is not one alone, value and sigma are the root mean
    square of what it adds in the first recording. made: its kind and its numbers; coefficients: of
    a curve, those of its splines or waves."""

    formula: str
    value: float
    sigma: float
    unit: str
    log_evidence_gain: float
    story: str = ""
    channels: tuple[str, ...] = ()
    drivers: tuple[str, ...] = ()
    curve: Curve | None = None
    constants: tuple[Parameter, ...] = ()
    made: tuple[str, tuple[float, ...]] | None = None
    coefficients: tuple[float, ...] = ()


# Of what was not tried, so much in a warning; the verdict and ``untried`` have all.
NAMED = 3


def broken_off(untried: Sequence[str]) -> str | None:
    """That a search was cut short before it tried these; None where it was not."""
    if not untried:
        return None
    some = ", ".join(untried[:NAMED])
    if (more := len(untried) - NAMED) > 0:
        some += f" and {more} more"
    return (
        f"The search ended before all had been tried: {some}. Run again with a longer --budget, "
        "or with none, to see whether they change the result."
    )


def is_curve(formula: str) -> bool:
    """Whether a law is a curve, and no formula."""
    return formula.partition(" += ")[2].startswith(("g(", "g_i("))


@dataclass(frozen=True)
class Hand:
    """What the hand does: "held" (a point, but for sway), "creeping" (that point drifts),
    "carried" (still in its rests alone), "" (not asked: a pose or a reference tells); and the
    probability of that against what else was tried."""

    id: str
    probability: float


@dataclass(frozen=True)
class Hypothesis:
    """One effect on trial: evidence gained by it alone over the baseline, and in the end.

    alone: nats over the baseline; final: nats over the final model without it, for those
    in the final model, else over the final model with it added. expected: nats that the
    information matrix promises for an amplitude of one prior sigma; NaN for noise and outliers,
    of which no such matrix speaks. probability: posterior.
    verdict: "named", "set" (a member of an indistinguishable set), "" (not present).
    """

    effect: str
    title: str
    alone: float
    final: float
    expected: float
    probability: float
    verdict: str


# Nats, odds of twenty to one: what an effect must promise to be looked for.
ENOUGH_TO_SHOW = 3.0


def hardly_shown(hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
    """Effects that a motion would not have shown at their usual size."""
    return [h for h in hypotheses if not h.verdict and h.expected < ENOUGH_TO_SHOW]


@dataclass(frozen=True, repr=False)
class Trace(Brief):
    """Simulated against recorded, in sensor units, for one channel of one recording.

    t (k,) s; recorded, before, after (k,): the reading and what the fitted baseline and the
    final model say it should have been; sigma (k,): one standard deviation of what the
    model allows at this smoothing; unit. Smoothed over a tenth of a second and thinned. left_out:
    readings that the final model does without, which are not among them.
    """

    channel: str
    t: Array
    recorded: Array
    before: Array
    after: Array
    sigma: float
    unit: str
    left_out: int = 0


@dataclass(frozen=True, repr=False)
class Evidence(Brief):
    """Where the evidence came from: cumulated gain (k,) nats over t (k,) s of each effect, final
    model against the same without it."""

    t: Array
    gain: Mapping[str, Array]


@dataclass(frozen=True)
class Fit:
    """How well a model fits: evidence, residuals (root mean square, sensor units), NIS per
    degree of freedom and whiteness (lag-one autocorrelation of innovations) by channel or kind."""

    log_evidence: float
    residual_rms: Mapping[str, float]
    nis: Mapping[str, float]
    whiteness: Mapping[str, float]


@dataclass(frozen=True)
class HeldOut:
    """Scores on data that the fit has not seen; higher log scores are better.

    source: "later blocks" or the names of the files.
    """

    source: str
    log_score_before: float
    log_score_after: float
    residual_rms_before: Mapping[str, float]
    residual_rms_after: Mapping[str, float]


@dataclass(frozen=True)
class NextMotion:
    """A motion to make next: which effects it separates and the nats it promises."""

    motion: str
    separates: tuple[str, ...]
    expected_gain: float


@dataclass(frozen=True, repr=False)
class Explained(Brief):
    """One of the recordings: how it looked against the model.

    parameters: biases and other things of its own; shortfall: for each channel (k,) nats
    lost in time bins ``bins`` (k + 1,) s against what the model expects of itself. twins: the
    recording as the baseline and as the final model say that it read. read: the recording as it
    was read, where ``recording`` may hold averages of it. drifts, moves: whether a held point does.
    marker: None without a pose.
    """

    recording: Recording
    assume: str
    parameters: tuple[Parameter, ...]
    noise: tuple[NoiseLevel, ...]
    traces: tuple[Trace, ...]
    evidence: Evidence
    bins: Array
    shortfall: Mapping[str, Array]
    rests: Array
    twins: tuple[Recording, Recording] | None = None
    read: Recording | None = None
    drifts: bool = False
    moves: bool = False
    marker: MarkerRotation | None = None

    @property
    def as_read(self) -> Recording:
        """The recording with every reading of the sensor."""
        return self.read or self.recording


@dataclass(frozen=True, repr=False)
class Explanation(Brief):
    """All that ``explain`` says of one device.

    parameters, noise: of the final model (noise of the first recording); missing is ordered by
    share; hypotheses by ``alone``; model: the final model, whose fit ``calibrate`` repeats;
    untellable: what the recordings cannot show, with the sigma that they would leave of it;
    untried: what the search left out because it had only so much time, in words; covariance: of
    ``parameters``; device: what was known of the device; likelihood: what the one recording says
    itself; impossible: residuals that no hand makes; doubts: why its numbers deserve less trust, as
    far as only the fit tells that; each in sentences.
    """

    verdict: str
    mismatch: tuple[Mismatch, ...]
    missing: tuple[Missing, ...]
    unnamed: tuple[Unnamed, ...]
    hypotheses: tuple[Hypothesis, ...]
    before: Fit
    after: Fit
    held_out: HeldOut | None
    next_motion: tuple[NextMotion, ...]
    parameters: tuple[Parameter, ...]
    noise: tuple[NoiseLevel, ...]
    recordings: tuple[Explained, ...]
    warnings: tuple[str, ...]
    model: Specification | None = None
    untellable: tuple[Parameter, ...] = ()
    hand: Hand = Hand("", 1.0)
    untried: tuple[str, ...] = ()
    covariance: Array | None = None
    device: Prior | None = None
    likelihood: Likelihood | None = None
    impossible: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
