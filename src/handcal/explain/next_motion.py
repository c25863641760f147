"""Which motion would tell what this recording could not: the information matrix decides.

For each motion of ``design`` the readings that it would add are linearised about the truth,
at the noise that was found. If effect a is the truth, the posterior of the model with a
predicts those readings, and so does that of the model with a rival b; the log-evidence that
a is expected to gain over b is how far the two predictions lie apart (their
Kullback-Leibler divergence), Occam's factors and all that b can mimic included. Of an exact
gauge it is nothing, whatever the motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from handcal.effects import Effect
from handcal.estimate.case import Case, name_of, problem_with
from handcal.estimate.evidence import ReducedPass, reduce, reduced_pass
from handcal.estimate.linear import linearise_about
from handcal.estimate.model import Fitted
from handcal.estimate.observed import observed_of
from handcal.estimate.prior_root import prior_root
from handcal.estimate.problem import Problem
from handcal.estimate.quadratic import Posterior, Quadratic, local, posterior
from handcal.estimate.trajectory import Trajectory, epochs
from handcal.explanation import (
    ENOUGH_TO_SHOW,
    Hypothesis,
    Missing,
    NextMotion,
    hardly_shown,
)
from handcal.motions import EARTH_FIELD, MOTIONS, Motion, attitude, rate_of, recording_of
from handcal.observations.magnetometer import HORIZONTAL, UPWARD
from handcal.recordings import segment
from handcal.recordings.streams import STREAMS
from handcal.search.common_found import names_of
from handcal.search.multistart import Found
from handcal.search.space import Space, expected_gain
from handcal.types import Array, HandcalError, IntArray

# Motions that are proposed, at the most.
MOST = 3


def next_motions(
    found: Found,
    missing: Sequence[Missing],
    hypotheses: Sequence[Hypothesis],
    verdict: str,
    motions: Sequence[Motion] = MOTIONS,
) -> tuple[NextMotion, ...]:
    """The motions that set apart what looked alike, then one that shows what was hidden. motions:
    of which they are chosen.

    Nothing where nothing needs telling, or where none of the motions would tell.
    """
    where = found.space
    chosen, names = found.model.chosen, names_of(where, found.model)
    sets = [_members(where, chosen, m) for m in missing if m.indistinguishable_from]
    hidden: list[str] = []
    if verdict in ("nothing_missing", "cannot_tell"):
        rivals = {i for set_ in sets for i in set_}
        low = {h.effect for h in hardly_shown(hypotheses)}
        hidden = [i for i in where.effects if i in low and i not in names | rivals]
    if not sets and not hidden:
        return ()
    wanted = chosen.union(hidden, *sets)
    information = _informations(found, wanted, motions)
    out: list[NextMotion] = []
    for set_ in sets:
        out += _separating(where, information, chosen, set_)
    out = sorted(out, key=lambda n: -len(n.separates))[:MOST]
    if hidden and len(out) < MOST:
        out += _revealing(where, information, chosen, hidden)
    return tuple(out)


def _members(where: Space, chosen: frozenset[str], missing: Missing) -> list[str]:
    """Ids of a set's members as the space has them, the one in the model first."""
    names = missing.effect, *missing.indistinguishable_from
    own = next(i for name in names for i in sorted(chosen) if name_of(i) == name)
    out = [own]
    for name in names:
        same = [i for i in where.effects if name_of(i) == name and i not in chosen]
        if same:
            out.append(max(same, key=lambda i: where.score((chosen - {own}) | {i})))
    return out


def _informations(
    found: Found, wanted: frozenset[str], motions: Sequence[Motion] = MOTIONS
) -> dict[Motion, Array]:
    """What each motion would tell of the space's parameters: G (k, k) of each motion that
    can be made sense of with the streams there are."""
    f, where = found.model.parts[0], found.space
    processes = [e for e in found.model.effects if e.process is not None]
    # A step happens once, and a term without a name is that of its own recording.
    lasting = [where.effects[i] for i in sorted(wanted) if name_of(i) == i and "+=" not in i]
    if not lasting:
        return {}
    warmth = "temperature" in f.case.recording.streams
    out = {}
    for motion in motions:
        if motion.warming and not warmth:
            continue
        try:
            out[motion] = _information(motion, f, [*lasting, *processes], where)
        except HandcalError:
            continue
    return out


def _information(motion: Motion, like: Fitted, effects: Sequence[Effect], where: Space) -> Array:
    done = motion_pass(motion, like.case, like.levels, effects)
    q = local(done, frozenset(e.id for e in effects)).quadratic
    at = np.array([where.quadratic.names.index(n) for n in q.names], dtype=np.int64)
    G = np.zeros_like(where.quadratic.G)
    G[np.ix_(at, at)] = q.G
    return G


def motion_pass(
    motion: Motion, like: Case, levels: Mapping[str, float], effects: Sequence[Effect]
) -> ReducedPass:
    """What a motion would tell, observed as a recording was and at noise levels as found there.

    Levels that are not given are first guesses. Errors: HandcalError where the motion makes
    no sense with that recording's streams.
    """
    case = _case(motion, like)
    problem = problem_with(case, effects)
    linear = linearise_about(problem, case.start, _truth(motion, problem))
    own = {lv.name: levels.get(lv.name, lv.initial) for lv in problem.levels}
    if "heading_noise" in own and "heading" in like.recording.streams:
        rate = rate_of(like.recording.streams["heading"])
        own["heading_noise"] *= min(1.0, STREAMS["heading"].planned_hz / rate) ** 0.5
    return reduced_pass(reduce(linear), own)


def _case(motion: Motion, like: Case) -> Case:
    """The motion observed as the recording was."""
    fields = [rows.z[0] for o, rows, _ in like.observed if o.kind == "magnetometer"]
    field = (float(fields[0][HORIZONTAL]), float(fields[0][UPWARD])) if fields else EARTH_FIELD
    recording = recording_of(motion, like.recording, like.earth[0], field)
    rests = segment.rests(recording)
    # that a recording lay still says nothing of the next
    held = like.assume == "fixed-point"
    kinds = [k for k in like.kinds if not (held and k == "zero_rate")]
    observed, start = observed_of(recording, kinds, rests, like.earth, None, np.zeros(3))
    return Case(recording, like.assume, tuple(observed), rests, like.earth, start, ())


def _truth(motion: Motion, problem: Problem) -> Trajectory:
    node = epochs(problem)
    still, k = np.zeros((len(node), 3)), len(node)
    C, _ = attitude(motion, problem.nodes.t[node])
    return Trajectory(
        node, still, still.copy(), C, np.zeros(3), np.zeros(3),
        np.zeros(problem.constants), np.zeros((k, problem.markov_size)),
    )  # fmt: skip


@dataclass(frozen=True)
class _Believed:
    """A set of effects in the space: where its parameters are, the prior's root, and what the
    recordings say of them."""

    index: IntArray
    root: Array | None
    now: Posterior


def _believed(where: Space, ids: frozenset[str]) -> _Believed:
    names = sorted(ids)
    parts = [where.where[i] for i in names]
    index = np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
    root = prior_root(where.quadratic, [where.effects[i] for i in names], index)
    return _Believed(index, root, posterior(where.quadratic, index, root))


def evidence_gained(q: Quadratic, G: Array, truth: _Believed, model: _Believed) -> float:
    """Mean log-evidence that a model gains from readings of information G (k, k), if those
    are as the posterior of ``truth`` predicts.

    Given u, the readings' score is N(G u, G); u ~ N(mean, covariance) of the truth's posterior.
    """
    a, m = truth.index, model.index
    more = Quadratic(q.names, q.a, q.b + G[:, a] @ truth.now.mean, q.G + G)
    then = posterior(more, m, model.root)
    cross = G[np.ix_(m, a)]
    spread = G[np.ix_(m, m)] + cross @ truth.now.covariance @ cross.T
    mean = then.log_evidence + 0.5 * float(np.sum(then.covariance * spread))
    return mean - model.now.log_evidence


def _apart(where: Space, G: Array, rest: frozenset[str], a: str, b: str) -> float:
    """Nats that the motion is expected to add for the truth, whichever of a and b it is:
    the less of both."""
    models = [_believed(where, rest | {i}) for i in (a, b)]
    q = where.quadratic

    def gain(truth: _Believed, rival: _Believed) -> float:
        return evidence_gained(q, G, truth, truth) - evidence_gained(q, G, truth, rival)

    return min(gain(models[0], models[1]), gain(models[1], models[0]))


def _separating(
    where: Space, information: Mapping[Motion, Array], chosen: frozenset[str], set_: Sequence[str]
) -> list[NextMotion]:
    """Motions that together separate all pairs of a set which any of them separates: first the
    one that separates most pairs, of several the one whose least gain is highest."""
    rest = chosen - {set_[0]}
    gains = {
        m: {(a, b): _apart(where, G, rest, a, b) for a, b in combinations(set_, 2)}
        for m, G in information.items()
    }
    left = set(combinations(set_, 2))
    out: list[NextMotion] = []
    while left and gains:
        told = {m: {p: g[p] for p in left if g[p] >= ENOUGH_TO_SHOW} for m, g in gains.items()}
        best = max(told, key=lambda m: (len(told[m]), min(told[m].values(), default=0.0)))
        if not told[best]:
            break
        members = _mutually(set_, gains[best], told[best])
        gain = min(gains[best][p] for p in combinations(members, 2))
        out.append(NextMotion(best.sentence, tuple(map(name_of, members)), gain))
        left -= set(told[best])
    return out


def _mutually(
    set_: Sequence[str],
    gains: Mapping[tuple[str, str], float],
    told: Mapping[tuple[str, str], float],
) -> list[str]:
    """Members of which each is separated from every other, beginning with a pair of ``told``."""
    first = min(told, key=lambda p: (set_.index(p[0]), set_.index(p[1])))
    members = list(first)
    for i in set_:
        if i not in members:
            order = [tuple(sorted((i, j), key=set_.index)) for j in members]
            if all(gains[a, b] >= ENOUGH_TO_SHOW for a, b in order):
                members.append(i)
    return sorted(members, key=set_.index)


def _revealing(
    where: Space, information: Mapping[Motion, Array], chosen: frozenset[str], hidden: Sequence[str]
) -> list[NextMotion]:
    """The motion that would show most of the effects that were hidden, at their usual sizes."""
    best: tuple[int, float, list[str], Motion] | None = None
    for motion, G in information.items():
        q = where.quadratic
        more = replace(where, quadratic=replace(q, G=q.G + G), scores={})
        gains = {i: expected_gain(more, i, chosen, np.ones(len(where.where[i]))) for i in hidden}
        shown = sorted((i for i in hidden if gains[i] >= ENOUGH_TO_SHOW), key=lambda i: -gains[i])
        least = min((gains[i] for i in shown), default=0.0)
        if shown and (best is None or (len(shown), least) > best[:2]):
            best = (len(shown), least, shown, motion)
    if best is None:
        return []
    _, least, shown, motion = best
    return [NextMotion(motion.sentence, tuple(map(name_of, shown)), least)]
