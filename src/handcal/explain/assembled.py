"""The conclusions of a search, where it ended: what has a name and what has none, the verdict, and
every number that goes with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from handcal.compiled.kernel import MAX_DIM
from handcal.device.twin import twin
from handcal.estimate.case import name_of
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.impossible import strange
from handcal.estimate.model import Fitted, Model
from handcal.estimate.parameters import known
from handcal.estimate.result import MOVED, noise, results
from handcal.estimate.robust import inflation
from handcal.estimate.specification import Specification
from handcal.estimate.start import BIASES
from handcal.explain import held_out as held
from handcal.explain import importance, locate
from handcal.explain.gauge import plainly, renamed
from handcal.explain.impossible import impossible
from handcal.explain.leaning import leaning
from handcal.explain.moments import moments
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
from handcal.explain.untellable import untellable
from handcal.explanation import (
    Evidence,
    Explained,
    Explanation,
    Fit,
    HeldOut,
    Hypothesis,
    Mismatch,
    Missing,
    Unnamed,
    broken_off,
)
from handcal.search import outliers
from handcal.search.hand_assumption import hand_of
from handcal.search.multistart import Found
from handcal.search.plausible import too_large
from handcal.types import Array, Parameter, Prior, Result

# Nats below which a recording does not promise to show an effect of the usual size.
FAINT = 10.0


@dataclass(frozen=True)
class End:
    """Where a search ended. base: the baseline; wrong: the headings that are merely wrong; surely:
    nats by which its hand is better than what was tried instead, NaN if nothing was; rests:
    whether some hand travels, so that its rests alone count; moves: whether the baseline is of a
    hand that moves, and was begun from fits of one that does not; left: what was found of laws that
    do not count, and were taken out of the model, in sentences."""

    base: Model
    found: Found
    wrong: outliers.Wrong | None
    surely: float
    rests: bool = False
    moves: bool = False
    left: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Named:
    """What has a name and what has none, and the verdict; alone: probability of each effect that
    it is no part of what has none; remarks: of the hand's part."""

    verdict: str
    missing: list[Missing]
    unnamed: list[Unnamed]
    alone: Mapping[str, float]
    remarks: list[str]


def learnt_of(found: Found) -> dict[str, tuple[Parameter, ...]]:
    """Estimates of the parameters of a model's effects, by effect."""
    fit = known(found.model, 0, inflation(found.model), moments(found)).parameters
    return {e.id: parameters_of(fit, e) for e in found.model.effects if e.process is None}


def uncounted(end: End) -> dict[str, str]:
    """Laws of the model that do not count, each with a sentence about it, by id: they add next to
    nothing, and nothing without a name adds more."""
    found = end.found
    if all("+=" not in e.id for e in found.model.effects):
        return {}
    laws, _ = _without_name(found, learnt_of(found))
    counts = end.wrong is not None and end.wrong.burst is not None
    if counts or not all(next_to_nothing(found.model, u) for u in laws):
        return {}
    return {u.formula: remark(u) for u in laws}


def _without_name(
    found: Found, learnt: Mapping[str, tuple[Parameter, ...]]
) -> tuple[list[Unnamed], list[Unnamed]]:
    """What has no name, and what of it may as well be the hand. (That stays in the model, as the
    rest of what the hand does: without it numbers were 4 sigma off, and a name was wrong.)"""
    cases = [f.case for f in found.model.parts]
    unnamed: list[Unnamed] = []
    lent: list[Unnamed] = []
    for u in unnamed_of(found, found.model.chosen, learnt):
        (lent if by_the_hand(u, cases) else unnamed).append(u)
    return unnamed, lent


def _named(
    end: End,
    learnt: Mapping[str, tuple[Parameter, ...]],
    wrong: outliers.Wrong | None,
    whole: bool,
    no_hand: bool,
) -> _Named:
    """no_hand: what the fit leaves is no hand's, and nothing is named."""
    found, burst_of = end.found, None if end.wrong is None else end.wrong.burst
    entries, unsure = entries_of(found, found.model.chosen, learnt, wrong)
    unnamed, lent = _without_name(found, learnt)
    remarks = [hand_remark(u) for u in lent]
    if end.wrong is not None and burst_of is not None:
        unnamed.append(burst(end.base, end.wrong, burst_of))
    if no_hand:
        return _Named("unexplained", [], unnamed, {}, remarks)
    if unnamed:
        alone = standing_out(found.model)
        missing = likely(entries, alone)
        return _Named("unexplained", missing, unnamed, alone, remarks)
    missing = likely(entries, {})
    # (that this is all only a search says that was not broken off)
    settled = "explained" if missing else "nothing_missing"
    verdict = settled if whole and not unsure else "cannot_tell"
    return _Named(verdict, missing, [], {}, remarks)


def _compared(
    end: End, model: Model, verdict: str, fits: Sequence[Result]
) -> tuple[list[Fitted], list[Explained], list[Mismatch]]:
    """The baseline at the model's noise, each recording before and after, and where they differ."""
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
    return [f.bare for f in before], explained, sorted(mismatch, key=lambda m: -m.share)


def explanation_of(
    end: End,
    plainest: Model,
    scores: HeldOut,
    written: Specification | None,
    judged: importance.Judged | None,
    untried: tuple[str, ...] = (),
) -> Explanation:
    """All that is said of the end of a search.

    plainest: the model of what was found alone, which is compared with the baseline; written: the
    whole model as ``calibrate --from`` repeats it; judged: by unseen data; untried: what there was
    no time for.
    """
    found, base, model = end.found, end.base, end.found.model
    wrong = None if end.wrong is None or end.wrong.burst is not None else end.wrong
    fits = results(model, moments(found) if written is None else written.moments)
    learnt = {
        e.id: parameters_of(fits[0].parameters, e) for e in model.effects if e.process is None
    }
    no_hand = impossible(plainest, fits[0].parameters, gravity_of(model))
    named = _named(end, learnt, wrong, not untried, bool(no_hand))
    doubts = _doubts(model, written, fits)
    before, explained, mismatch = _compared(end, plainest, named.verdict, fits)
    excess = inflation(model)
    told = _weighed(end, named, judged, excess)
    hypotheses = renamed(model, told, hypotheses_of(found, told, wrong, named.alone))
    final = _in_order(explained, learnt, fits[0])
    warnings = _warnings(base, model, told, hypotheses, excess)
    said = *no_hand, *warnings, *doubts, *named.remarks, *end.left, broken_off(untried)
    return Explanation(
        named.verdict,
        tuple(mismatch),
        tuple(told),
        tuple(named.unnamed),
        hypotheses,
        _fit(base, before),
        _fit(plainest, plainest.parts),
        scores,
        next_motions(found, named.missing, hypotheses, named.verdict),
        final,
        noise(model.parts[0]),
        tuple(explained),
        tuple(filter(None, said)),
        written,
        untellable(found, fits[0].parameters),
        hand_of(model.parts[0], end.surely),
        untried,
        _covariance(fits[0], final),
        _before(model),
        fits[0].likelihood if len(fits) == 1 else None,
        no_hand,
        doubts,
    )


def _weighed(
    end: End, named: _Named, judged: importance.Judged | None, excess: Mapping[str, float]
) -> list[Missing]:
    """What is named, the largest first, each with what it matters."""
    found, left_out = end.found, 0.0 if end.wrong is None else end.wrong.gain
    told = [
        plainly(found.model, importance.weighed(found, m, judged, left_out), excess)
        for m in named.missing
    ]
    return sorted(told, key=lambda m: (-m.share, -m.log_evidence_gain))


def _in_order(
    explained: Sequence[Explained], learnt: Mapping[str, tuple[Parameter, ...]], fit: Result
) -> tuple[Parameter, ...]:
    """What all recordings share, and the biases where there is but one; in the order of
    ``calibrate``."""
    own = explained[0].parameters if len(explained) == 1 else ()
    at = {(p.effect, p.name): k for k, p in enumerate(fit.parameters)}
    shared = (p for known in learnt.values() for p in known)
    return tuple(sorted((*own, *shared), key=lambda p: at[p.effect, p.name]))


def _covariance(fit: Result, parameters: Sequence[Parameter]) -> Array:
    """Of these parameters of a fit."""
    at = {(p.effect, p.name): i for i, p in enumerate(fit.parameters)}
    rows = [at[p.effect, p.name] for p in parameters]
    return fit.covariance[np.ix_(rows, rows)]


def _before(model: Model) -> Prior | None:
    """What the final fit was told of the device: its effects only where they were fitted so."""
    before = model.parts[0].case.before
    if before is None or model.known is not None:
        return before
    at = [i for i, n in enumerate(before.names) if n in BIASES]
    names = tuple(before.names[i] for i in at)
    return replace(
        before, names=names, mean=before.mean[at], covariance=before.covariance[np.ix_(at, at)]
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
        after.case.read,
        after.case.creeping,
        after.case.moves,
        result.marker,
    )


def _evidence(f: Fitted, model: Model) -> Evidence:
    """Cumulated gain of each effect: the prediction of every scalar with it against without."""
    done = reduced_pass(reduce(f.linear), f.levels)
    scalars = np.diff(done.reduction.first)
    at = np.repeat(done.reduction.linear.t, scalars)
    w = done.w
    slots = f.problem.slots
    nu = done.innovations(w)
    grid = np.linspace(f.t[0], f.t[-1], 400)
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
    for f in (f.bare for f in parts):
        done = reduced_pass(reduce(f.linear), f.levels)
        nu = done.innovations(done.w) / np.sqrt(done.S)
        slot = done.reduction.slot
        for k, observation in enumerate(f.problem.observations):
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
    base: Model,
    model: Model,
    missing: Sequence[Missing],
    hypotheses: Sequence[Hypothesis],
    excess: Mapping[str, float],
) -> tuple[str, ...]:
    not_seen = {h.effect for h in hypotheses if h.expected < FAINT or h.final > 0.0}
    out = [w for f in base.parts for w in f.case.warnings]
    named = {i for m in missing for i in (m.effect, *m.indistinguishable_from)}
    unnamed = {e.id for e in model.effects if e.common and e.id not in named}
    for f in model.parts:
        out += leaning(f, model.effects, not_seen, unnamed, excess)
    return tuple(dict.fromkeys(out))


def gravity_of(model: Model) -> float:
    """Gravity where the first recording was made, m/s^2."""
    return float(np.linalg.norm(model.parts[0].problem.g_n))


def _doubts(model: Model, written: Specification | None, fits: Sequence[Result]) -> tuple[str, ...]:
    """Why the numbers of the final fit deserve less trust."""
    out = [said for fit in fits for said in fit.doubts]
    out += [] if model.settled else [MOVED]
    if large := strange(too_large(model)):
        out.append(large)
    if written is None:
        out.append(
            "The final fit is reached by the way of the search alone, not from its own start: it "
            "cannot be repeated with --from, and its numbers deserve little trust."
        )
    return tuple(dict.fromkeys(out))
