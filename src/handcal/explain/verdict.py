"""``explain``: from recordings of one device to a verdict, with its proof."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from handcal.compiled.kernel import MAX_DIM
from handcal.device.twin import twin
from handcal.effects import catalogue
from handcal.estimate.baseline import baseline, started
from handcal.estimate.case import Case, case_of, name_of
from handcal.estimate.chosen import Chosen, Options, as_seen, chosen_of, seen, settled
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import fitted, scan
from handcal.estimate.hand import resting, travels
from handcal.estimate.model import Fitted, Model
from handcal.estimate.observed import check_options
from handcal.estimate.result import noise, results
from handcal.estimate.robust import inflation
from handcal.explain import held_out as held
from handcal.explain import importance, locate, outliers
from handcal.explain.bias_limits import leaning
from handcal.explain.climb.state import sensible, too_large
from handcal.explain.explanation import (
    Evidence,
    Explained,
    Explanation,
    Fit,
    HeldOut,
    Mismatch,
    Missing,
    Unnamed,
)
from handcal.explain.gauge import plainly
from handcal.explain.hands import foretold, hand_of
from handcal.explain.moments import moments
from handcal.explain.moving import begun, moving
from handcal.explain.naming import (
    burst,
    by_the_hand,
    entries_of,
    hand_remark,
    hypotheses_of,
    likely,
    next_to_nothing,
    parameters_of,
    remark,
    standing_out,
    unnamed_of,
)
from handcal.explain.next_motion import next_motions
from handcal.explain.score import PRIOR, TERM_PRIOR
from handcal.explain.search import Found, advantage, search
from handcal.explain.space import gains, space
from handcal.explain.untellable import untellable
from handcal.types import Array, InputError, Parameter, Recording, Result

# Called with the share that is done, and what is being done.
Progress = Callable[[float, str], None]
# Nats by which a fit from the start may do worse than that at the end of a search: as good, and
# no fit of the same model at all.
SAME, LOST = 1.0, 100.0
# Nats below which a recording does not promise to show an effect of the usual size.
FAINT = 10.0


def explain(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    *,
    assume: str = "auto",
    heading_sigma: float | None = None,
    latitude: float | None = None,
    height: float = 0.0,
    ignore: Sequence[str] = (),
    reference_exact: bool = False,
    progress: Progress | None = None,
) -> Explanation:
    """Say which physics the baseline lacks to explain these recordings of one device.

    held_out: other recordings of the same device, for scoring alone; without any, later
    blocks are predicted from earlier ones. Other options as in ``calibrate``. Raises
    InputError for wrong use, HandcalError where no result could be made.
    """
    report = progress or (lambda _, __: None)
    if not recordings:
        raise InputError("There is no recording to explain.")
    for recording in recordings:
        check_options(recording, assume, heading_sigma, ignore)
    fixed = {} if heading_sigma is None else {"heading_noise": heading_sigma}
    options = Options(latitude, height, fixed, tuple(ignore), reference_exact)
    cases = [_case(r, assume, options) for r in recordings]
    report(0.03, "fitting the baseline")
    end = _searched(begun(cases), lambda f: report(0.1 + 0.6 * f, "searching what is missing"))
    if assume == "auto":
        end = _by_the_rests(cases, end, options, report)
    report(0.75, "fitting the model that was found")
    found, chosen = _refitted(end, end.found, options)
    if large := too_large(found.model):
        # (the search did not come so far)
        other = search(end.base, lambda f: report(0.75 + 0.05 * f, "searching again"), large)
        again, written = _refitted(end, other, options)
        if sensible(again.model):
            found, chosen = replace(again, alone=end.found.alone), written
    end = replace(end, found=found)
    report(0.8, "predicting what was not seen")
    others = [_case(r, "rest-only" if end.rests else assume, options) for r in held_out]
    scores, judged = _predicted(end, others)
    report(0.9, "judging what this motion could tell")
    out = _explanation(end, scores, chosen, judged)
    report(1.0, "")
    return out


def _predicted(end: _End, others: Sequence[Case]) -> tuple[HeldOut, importance.Judged | None]:
    """How well what was not seen is predicted: other recordings, or else later blocks."""
    found = end.found
    if not others:
        return held.later_blocks(end.base, found.model), importance.by_later_blocks(found)
    scores, after = held.other_files(others, found.model)
    return scores, importance.by_other_files(found, after)


def _case(recording: Recording, assume: str, options: Options) -> Case:
    o = options
    return case_of(
        recording, assume, o.latitude, o.height, o.ignore, o.fixed,
        reference_exact=o.reference_exact,
    )  # fmt: skip


@dataclass(frozen=True)
class _End:
    """Where a search ended. base: the baseline; wrong: the headings that are merely wrong; surely:
    nats by which its hand is better than what was tried instead, NaN if nothing was; rests:
    whether some hand travels, so that its rests alone count; moves: whether the baseline is of a
    hand that moves, and was begun from fits of one that does not."""

    base: Model
    found: Found
    wrong: outliers.Wrong | None
    surely: float
    rests: bool = False
    moves: bool = False


def _by_the_rests(cases: Sequence[Case], end: _End, options: Options, report: Progress) -> _End:
    """The end of a search by the rests alone, where a hand seems to travel and they know better.

    (Only after the search: errors of the sensors look like a travelling hand too.)
    """
    far = [travels(f) for f in end.found.model.parts]
    if not any(far):
        return end
    laid = baseline(
        [
            resting(f, options.latitude, options.height) if gone else case
            for case, f, gone in zip(cases, end.found.model.parts, far, strict=True)
        ]
    )
    if not math.isfinite(laid.log_evidence):
        return end
    other = _searched(laid, lambda f: report(0.4 + 0.3 * f, "searching by the rests alone"))
    surely = foretold(end.found.model, laid, other.found)
    if surely > 0.0:
        return replace(end, surely=surely)
    return replace(other, surely=-surely, rests=True)


def _refitted(end: _End, found: Found, options: Options) -> tuple[Found, Chosen | None]:
    """The model that a search ended with, fitted from where any other would be, as
    ``calibrate`` does; and as it is written down: None where no fit from there is any good."""
    searched, base = found.model, end.base
    chosen = chosen_of(searched, options, moments(found))
    if end.moves or not as_seen(base.parts, chosen):
        parts = zip(searched.parts, chosen.views, strict=True)
        base = baseline([seen(f.case.read or f.case.recording, v, options) for f, v in parts])
    model = settled(base, chosen)
    if not sensible(model) or model.log_evidence < searched.log_evidence - SAME:
        exact = chosen_of(searched, options, moments(found), exact=True)
        other = settled(base, exact)
        ends = (model, chosen), (other, exact)
        model, chosen = max(ends, key=lambda end: (sensible(end[0]), end[0].log_evidence))
    if model.log_evidence < searched.log_evidence - LOST:
        return found, None
    return _with(found, model), chosen


def _with(found: Found, model: Model) -> Found:
    """The end of the search with another fit of its model."""
    candidates = list(found.space.effects.values())
    where = space(scan(model, candidates), candidates, found.space.prior)
    return replace(found, model=model, space=where)


def _searched(base: Model, report: Callable[[float], None]) -> _End:
    """Where the search from this baseline ends."""
    cleaned, wrong = outliers.cleaned(base)

    found = search(cleaned, report)
    if wrong is not None and wrong.burst is None:
        whole = outliers.put_back(base, found.model)
        if found.model.log_evidence - whole.log_evidence + PRIOR < 0.0:
            found, wrong = _with(found, whole), None
    if wrong is not None and (wrong.burst or any(e.held for e in found.model.effects)):
        # what comes one after the other may be a heading that errs by a known effect, and a step
        # has its moment from the very readings that were left out
        other = search(base, report)
        if advantage(other, found) > (TERM_PRIOR if wrong.burst else PRIOR):
            found, wrong = other, None
    if wrong is None:
        found, wrong = _without_outliers(base, found, report)
    other_hand = moving(base, found.model, _gained(found)) if wrong is None else None
    if other_hand is None:
        return _End(base, found, wrong, math.nan)
    base, surely = other_hand
    return _End(base, search(base, report), wrong, surely, moves=True)


def _gained(found: Found) -> dict[str, float]:
    """Nats that each effect of the model gains."""
    return gains(found.space, found.model.chosen) | found.noise


def _without_outliers(
    start: Model, found: Found, report: Callable[[float], None]
) -> tuple[Found, outliers.Wrong | None]:
    """The search once more without headings that stand out from their neighbours: about the
    baseline, physics that is missing may have hidden that they are wrong."""
    masks = outliers.standing_out(start)
    if masks is None:
        return found, None
    # (from the start again: they may have led the first trajectory astray)
    cases = [f.case for f in outliers.without(start, masks)]
    begin = [started(c, start.effects) for c in cases]
    other = search(fitted(begin, start.effects, noise_rounds=2), report)
    gain = advantage(other, found)
    if gain + PRIOR < 0.0:
        return found, None
    return replace(other, alone=found.alone), outliers.share(other.model, masks, gain)


@dataclass(frozen=True)
class _Named:
    """What has a name and what has none, and the verdict; alone: probability of each effect that
    it is no part of what has none; remarks: what without a name is too little for one."""

    verdict: str
    missing: list[Missing]
    unnamed: list[Unnamed]
    alone: Mapping[str, float]
    remarks: list[str]


def _named(
    end: _End, learnt: Mapping[str, tuple[Parameter, ...]], wrong: outliers.Wrong | None
) -> _Named:
    found, burst_of = end.found, None if end.wrong is None else end.wrong.burst
    entries, unsure = entries_of(found, found.model.chosen, learnt, wrong)
    cases = [f.case for f in found.model.parts]
    unnamed: list[Unnamed] = []
    lent: list[Unnamed] = []
    for u in unnamed_of(found, found.model.chosen, learnt):
        (lent if by_the_hand(u, cases) else unnamed).append(u)
    counts = any(not next_to_nothing(found.model, u) for u in unnamed)
    if end.wrong is not None and burst_of is not None:
        unnamed.append(burst(end.base, end.wrong, burst_of))
        counts = True
    alone = standing_out(found.model)
    missing, remarks = likely(entries, alone), [hand_remark(u) for u in lent]
    if counts:
        return _Named("unexplained", missing, unnamed, alone, remarks)
    missing = likely(entries, {})
    verdict = "cannot_tell" if unsure else "explained" if missing else "nothing_missing"
    return _Named(verdict, missing, [], {}, [*remarks, *(remark(u) for u in unnamed)])


def _compared(
    end: _End, verdict: str, fits: Sequence[Result]
) -> tuple[list[Fitted], list[Explained], list[Mismatch]]:
    """The baseline at the model's noise, each recording before and after, and where they differ."""
    model = end.found.model
    before = held.at_same_noise(end.base.parts, model.parts)
    if end.wrong is not None:
        before = list(end.base.parts)
    explained: list[Explained] = []
    mismatch: list[Mismatch] = []
    for k, (b, a) in enumerate(zip(before, model.parts, strict=True)):
        bins, short = locate.shortfall(b, a)
        if verdict != "nothing_missing":
            mismatch += locate.mismatches(b, bins, short, k)
        explained.append(_explained(b, a, bins, short, model, fits[k]))
    mismatch = [replace(m, share=m.share / len(model.parts)) for m in mismatch]
    return before, explained, sorted(mismatch, key=lambda m: -m.share)


def _explanation(
    end: _End, scores: HeldOut, written: Chosen | None, judged: importance.Judged | None
) -> Explanation:
    found, base, model = end.found, end.base, end.found.model
    wrong = end.wrong if end.wrong is not None and end.wrong.burst is None else None
    fits = results(model, moments(found) if written is None else written.moments)
    learnt = {e.id: parameters_of(fits[0], e) for e in model.effects if e.process is None}
    named = _named(end, learnt, wrong)
    before, explained, mismatch = _compared(end, named.verdict, fits)
    excess = inflation(model)
    told = [plainly(model, importance.weighed(found, m, judged), excess) for m in named.missing]
    told.sort(key=lambda m: (-m.share, -m.log_evidence_gain))
    hypotheses = hypotheses_of(found, told, wrong, named.alone)
    # what all recordings share, and the biases where there is but one
    own = explained[0].parameters if len(explained) == 1 else ()
    return Explanation(
        named.verdict,
        tuple(mismatch),
        tuple(told),
        tuple(named.unnamed),
        hypotheses,
        _fit(base, before),
        _fit(model, model.parts),
        scores,
        next_motions(found, named.missing, hypotheses, named.verdict),
        (*own, *(p for known in learnt.values() for p in known)),
        noise(model.parts[0]),
        tuple(explained),
        (
            *_warnings(base, model, {h.effect for h in hypotheses if h.expected < FAINT}, written),
            *named.remarks,
        ),
        written,
        untellable(found, fits[0].parameters),
        hand_of(model.parts[0], end.surely),
    )


def _explained(
    before: Fitted,
    after: Fitted,
    bins: Array,
    short: Mapping[str, Array],
    model: Model,
    result: Result,
) -> Explained:
    return Explained(
        after.case.recording,
        after.case.assume,
        tuple(p for p in result.parameters if p.effect in ("gyro_bias", "accel_bias")),
        result.noise,
        locate.traces(before, after),
        _evidence(after, model),
        bins,
        short,
        after.case.rests,
        (twin(before.linear), twin(after.linear)),
        after.case.read_hz,
        after.case.creeping,
        after.case.moves,
    )


def _evidence(f: Fitted, model: Model) -> Evidence:
    """Cumulated gain of each effect: the prediction of every scalar with it against without."""
    done = reduced_pass(reduce(f.linear), f.levels)
    scalars = np.diff(done.reduction.first)
    at = np.repeat(done.reduction.linear.t, scalars)
    w = done.w
    slots = f.linear.problem.slots
    nu = done.innovations(w)
    grid = np.linspace(f.linear.t[0], f.linear.t[-1], 400)
    gain = {}
    A = done.log_likelihood[2] + np.eye(len(w))
    for e in model.effects:
        mine = np.array([6 + i for i, s in enumerate(slots) if s.owner == e.id], dtype=np.int64)
        if not len(mine):
            continue
        rest = np.setdiff1d(np.arange(len(w)), mine)
        other = w.copy()
        other[mine] = (
            -done.reduction.linear.trajectory.constants[mine - 6] / done.reduction.scale[mine]
        )
        change = A[np.ix_(rest, mine)] @ (other[mine] - w[mine])
        other[rest] = w[rest] - np.linalg.solve(A[np.ix_(rest, rest)], change)
        without = done.innovations(other)
        more = np.cumsum(0.5 * (without**2 - nu**2) / done.S)
        gain[name_of(e.id)] = np.interp(grid, at, more) if len(at) else np.zeros_like(grid)
    return Evidence(grid, gain)


def _fit(model: Model, parts: Sequence[Fitted]) -> Fit:
    nis: dict[str, list[float]] = {}
    white: dict[str, list[float]] = {}
    rms: dict[str, list[float]] = {}
    for f in parts:
        done = reduced_pass(reduce(f.linear), f.levels)
        nu = done.innovations(done.w) / np.sqrt(done.S)
        slot = done.reduction.slot
        for k, observation in enumerate(f.linear.problem.observations):
            for i, channel in enumerate(observation.channels):
                x = nu[slot == k * MAX_DIM + i]
                if len(x) > 10:
                    nis.setdefault(channel, []).append(float(np.mean(x**2)))
                    white.setdefault(channel, []).append(
                        float(np.mean(x[1:] * x[:-1]) / max(float(np.mean(x**2)), 1e-12))
                    )
        for channel, v in locate.residual_rms(f).items():
            rms.setdefault(channel, []).append(v)
    return Fit(
        model.log_evidence,
        {k: float(np.sqrt(np.mean(np.square(v)))) for k, v in rms.items()},
        {k: float(np.mean(v)) for k, v in nis.items()},
        {k: float(np.mean(v)) for k, v in white.items()},
    )


def _warnings(
    base: Model, model: Model, hardly_shown: Set[str], written: Chosen | None
) -> tuple[str, ...]:
    out = [w for f in base.parts for w in f.case.warnings]
    for f in model.parts:
        out += leaning(f, model.effects, hardly_shown)
    if not model.settled:
        out.append(
            "The final fit still moved after ten rounds of relinearisation; trust its numbers less."
        )
    if large := too_large(model):
        names = ", ".join(catalogue()[i].title.lower() for i in sorted(large & set(catalogue())))
        out.append(
            f"No device has as much of this as was found here: {names}. Something else that has no "
            "name stands behind it; take its numbers for no more than a sign of that."
        )
    if written is None:
        out.append(
            "The final fit is reached by the way of the search alone, not from its own start: it "
            "cannot be repeated with --from, and its numbers deserve little trust."
        )
    return tuple(dict.fromkeys(out))
