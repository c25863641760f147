"""What explains a recording best, by its matrix alone: sets of names, steps and noise.

A choice is a set of effects with a name (steps among them) and of noise processes at certain
levels. Its score is evidence plus log prior odds: noise is integrated out of the matrix, tails and
sparse groups of the names are as in every fit. The search goes uphill, in turn over names, two
sets at a time, so that of two that are alike both are gone on with, and over noise. Nothing is
fitted: a choice is a proposal, which a fit decides on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular

from handcal.effects import Effect, catalogue
from handcal.estimate.case import frozen_at, name_of
from handcal.estimate.quadratic import Quadratic
from handcal.laws import with_motion
from handcal.laws.law_effect import AXES_OF, SIZE
from handcal.laws.weighing import gains, wide_root
from handcal.search.response import (
    STEPS,
    Columns,
    Levels,
    Response,
    held,
    modes,
    noise_columns,
    products,
    sensor_of,
    step_columns,
)
from handcal.search.space import Space, space
from handcal.types import Array

# Sets of names that are gone on with; processes and moments of a step that are weighed exactly, the
# likeliest by a look.
BEAM, EXACT = 2, 3
# Nats that a change must gain.
GAINED = 0.5
# Log odds of what no fit wanted.
REFUSED = -1e6
# Times the first guess of its level at which noise is looked at.
SIZES = 10.0 ** np.arange(-2.0, 2.01, 0.25)
MEMORIES = (0.3, 1.0, 3.0, 10.0)
# Shares of the size at which noise is evaluated exactly.
SMALLER = (1.0, 0.56, 0.32)


@dataclass(frozen=True, eq=False)
class Choice:
    """names: ids of the effects with a name; noise: by its id each process as columns; score:
    evidence at its worth and log prior odds, nats; steps: that were on trial; where: all names that
    were."""

    names: frozenset[str]
    noise: Mapping[str, Columns]
    score: float
    steps: Sequence[Columns]
    where: Space

    @property
    def ids(self) -> frozenset[str]:
        """Ids of all effects."""
        return self.names | self.noise.keys()

    @property
    def effects(self) -> dict[str, tuple[Effect, Levels]]:
        """Each effect by its id, and its noise levels."""
        named: dict[str, tuple[Effect, Levels]] = {
            i: (self.where.effects[i], ()) for i in sorted(self.names)
        }
        return {**named, **{i: (c.effect, c.levels) for i, c in self.noise.items()}}


@dataclass(frozen=True)
class Priors:
    """of: log prior odds of an effect; refused: names and ids of noise that no fit wanted; always:
    ids of effects that every set has."""

    of: Callable[[Effect], float]
    refused: frozenset[str] = frozenset()
    always: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class Process:
    """Noise on trial, on all axes: its levels at the first guess of its size, and its columns."""

    effect: Effect
    levels: Levels
    F: Array


def select(
    r: Response,
    priors: Priors,
    processes: Sequence[Process],
    start: Iterable[str] = (),
) -> tuple[Choice, Choice]:
    """The choice at the start (these names, and noise of the model), and the best one that the
    search from it ends with."""
    first = present(r, priors, start)
    best = _over_names(r, priors, first.noise, first.names)
    while True:
        # (moments of steps are looked for anew)
        names = best.names & {e.id for e in r.effects}
        less, more = _other_noise(r, priors, best, processes)
        # (names can take the place of noise that goes; what comes is compared beside those there)
        beside = partial(chosen, r, priors, best.names, steps=best.steps)
        more = sorted(more, key=lambda noise: -beside(noise).score)[:1]
        tried = [_over_names(r, priors, other, names) for other in (*less, *more)]
        top = max(tried, key=lambda choice: choice.score, default=best)
        if top.score <= best.score + GAINED:
            return first, best
        best = top


def present(r: Response, priors: Priors, names: Iterable[str]) -> Choice:
    """These names, and the noise of the model, as a choice."""
    own = {e.id: e for e in r.noise}
    noise = {
        i: noise_columns(r, own[i] if i in own else with_motion.again(i), levels)
        for i, levels in r.levels.items()
    }
    return chosen(r, priors, frozenset(names), noise)


# --- Names ---------------------------------------------------------------------------------------


def space_beside(
    r: Response, priors: Priors, noise: Mapping[str, Columns], steps: Sequence[Columns] = ()
) -> Space:
    """The names on trial, steps at these moments among them, with noise integrated out."""
    q, m = r.quadratic, r.named
    b = np.concatenate([q.b[m], *(s.b for s in steps)])
    G = np.block(
        [
            [q.G[np.ix_(m, m)], *(s.along[:, m].T for s in steps)],
            *([s.along[:, m], *(products(s.along, t) for t in steps)] for s in steps),
        ]
    )
    a = r.worth * q.a
    if noise:
        some = list(noise.values())
        A = np.block([[products(x.along, y) for y in some] for x in some])
        X = np.block([[x.along[:, m], *(products(x.along, s) for s in steps)] for x in some])
        gained, b, G = _beside(A, np.concatenate([x.b for x in some]), X, b, G)
        a += r.worth * gained
    b, G = r.worth * b, r.worth * G
    names = [q.names[i] for i in m]
    names += [(s.effect.id, p.name) for s in steps for p in s.effect.parameters]
    effects = [*r.effects, *(s.effect for s in steps)]
    odds = {e.id: priors.of(e) for e in effects}
    odds |= {i: REFUSED for i in odds if name_of(i) in priors.refused}
    return space(Quadratic(tuple(names), a, b, G, r.worth), effects, odds)


def chosen(
    r: Response,
    priors: Priors,
    names: frozenset[str],
    noise: Mapping[str, Columns],
    steps: Sequence[Columns] = (),
) -> Choice:
    """These names, of which some may be steps, and this noise as a choice."""
    return _choice(space_beside(r, priors, noise, steps), priors, names, noise, steps)


def _choice(
    where: Space,
    priors: Priors,
    names: frozenset[str],
    noise: Mapping[str, Columns],
    steps: Sequence[Columns],
) -> Choice:
    odds = sum(priors.of(c.effect) for c in noise.values())
    return Choice(names, noise, where.score(names) + odds, steps, where)


def missed(r: Response, priors: Priors, choice: Choice) -> dict[str, float]:
    """Nats of score that a choice loses without each of its effects."""
    out = {
        i: choice.where.score(choice.names) - choice.where.score(choice.names - {i})
        for i in choice.names
    }
    for i in choice.noise:
        rest = {k: c for k, c in choice.noise.items() if k != i}
        out[i] = choice.score - chosen(r, priors, choice.names, rest, choice.steps).score
    return out


def _over_names(
    r: Response,
    priors: Priors,
    noise: Mapping[str, Columns],
    start: frozenset[str],
) -> Choice:
    """The best set of names beside some noise: moments of steps are looked at beside the best set
    without them."""
    where = space_beside(r, priors, noise)
    sets = best_sets(where, [start], priors.always)
    steps = _steps(r, priors, sets[0], noise)
    if steps:
        where = space_beside(r, priors, noise, steps)
        sets = best_sets(where, sets, priors.always)
    return _choice(where, priors, sets[0], noise, steps)


def best_sets(
    where: Space, starts: Sequence[frozenset[str]], always: frozenset[str], beam: int = BEAM
) -> list[frozenset[str]]:
    """The best sets of effects that are found from these, as many as the beam is wide, the best
    first: by adding and dropping those that are not always there, and then by exchanging them."""
    best = sorted(set(starts), key=where.score, reverse=True)[:beam]
    for neighbours in (_more_or_less, _neighbours):
        gone_on: set[frozenset[str]] = set()
        while new := [s for s in best if s not in gone_on]:
            gone_on.update(new)
            found = {n for s in new for n in neighbours(where, s, always)}
            # (in an order that is the same in every run)
            ranked = sorted(sorted({*best, *found}, key=sorted), key=where.score, reverse=True)
            best = ranked[:beam]
    return best


def _more_or_less(
    where: Space, chosen: frozenset[str], always: frozenset[str]
) -> Iterator[frozenset[str]]:
    yield from (chosen | {i} for i in where.effects if i not in chosen)
    yield from (chosen - {j} for j in sorted(chosen - always))


def _neighbours(
    where: Space, chosen: frozenset[str], always: frozenset[str]
) -> Iterator[frozenset[str]]:
    yield from _more_or_less(where, chosen, always)
    others = [i for i in where.effects if i not in chosen]
    yield from ((chosen - {j}) | {i} for j in sorted(chosen - always) for i in others)


# --- Windows -------------------------------------------------------------------------------------


def windows_beside(
    r: Response, names: frozenset[str], noise: Mapping[str, Columns], sensor: int
) -> tuple[Array, Array]:
    """b (a, n) and G (a, n, a, n) of a sensor's windows at the full likelihood, axis by axis, with
    these names and this noise integrated out."""
    q, w = r.quadratic, r.windows.of(sensor)
    effects = [e for e in r.effects if e.id in names]
    own = {e.id for e in effects}
    index = np.flatnonzero([owner in own for owner, _ in q.names])
    root = wide_root(q, effects, index)
    along = np.vstack([root.T @ q.G[index], *(c.along for c in noise.values())])
    own_b = np.concatenate([root.T @ q.b[index], *(c.b for c in noise.values())])
    A = np.hstack([along[:, index] @ root, *(products(along, c) for c in noise.values())])
    axes = len(AXES_OF[sensor])
    n = len(w) // axes
    _, b, G = _beside(A, own_b, along[:, w], q.b[w], q.G[np.ix_(w, w)])
    return b.reshape(axes, n), G.reshape(axes, n, axes, n)


def _beside(A: Array, own: Array, X: Array, b: Array, G: Array) -> tuple[float, Array, Array]:
    """A quadratic of others, b (k,) and G (k, k), with constants under priors of one integrated
    out: their matrix A (m, m), vector own (m,) and products X (m, k). Before it, what they gain,
    nats."""
    root = np.linalg.cholesky(A + np.eye(len(A)))
    h = solve_triangular(root, np.column_stack([own, X]), lower=True)
    first, rest = h[:, 0], h[:, 1:]
    gained = 0.5 * float(first @ first) - float(np.log(np.diag(root)).sum())
    return gained, b - rest.T @ first, G - rest.T @ rest


def _steps(
    r: Response, priors: Priors, names: frozenset[str], noise: Mapping[str, Columns]
) -> list[Columns]:
    """Steps at the likeliest edges of windows, beside these names and this noise."""
    out: list[Columns] = []
    known, have = catalogue(), {name_of(e.id) for e in r.effects}
    if len(r.windows.each) > 1:
        return out
    for name, sensor in STEPS.items():
        if name in have or name in priors.refused or sensor not in r.windows.sensors:
            continue
        effect, edges = known[name], r.windows.each[0].edges
        b, G = windows_beside(r, names, noise, sensor)
        nats = step_gains(r.worth * b, r.worth * G, effect.prior_sigma[0] / SIZE[sensor])
        for edge in _summits(nats)[:EXACT]:
            moment = np.zeros(len(effect.parameters))
            moment[-1] = edges[edge] - r.windows.motion[0].t[0]
            out.append(step_columns(r, frozen_at(effect, moment), edge))
    return out


def step_gains(b: Array, G: Array, size: float) -> Array:
    """Nats (n,) that a step from each window on gains, of this size on each axis in units of the
    windows, given b (a, n) and G (a, n, a, n)."""
    n = b.shape[1]
    after = size * np.cumsum(b[:, ::-1], axis=1)[:, ::-1]
    both = np.cumsum(G[:, ::-1], axis=1)[:, ::-1]
    both = size**2 * np.cumsum(both[:, :, :, ::-1], axis=3)[:, :, :, ::-1]
    at = np.arange(n)
    nats = gains(after.T, both[:, at, :, at])
    # (from the first window on it is a bias)
    nats[0] = -np.inf
    return nats


def _summits(nats: Array) -> list[int]:
    """Where these (n,) are higher than beside, the highest first."""
    beside = np.r_[-np.inf, nats, -np.inf]
    top = np.flatnonzero((nats > beside[:-2]) & (nats >= beside[2:]))
    return [int(i) for i in top[np.argsort(-nats[top], kind="stable")]]


# --- Noise ---------------------------------------------------------------------------------------


def processes_of(r: Response) -> list[Process]:
    """The processes on trial at several memories."""
    out = []
    for e in r.noise:
        size, *others = e.levels
        for times in product(*[MEMORIES] * len(others)):
            levels = {size.name: size.initial}
            for lv, by in zip(others, times, strict=True):
                levels[lv.name] = min(max(by * lv.initial, lv.lower), lv.upper)
            each = [levels] * len(r.windows.each)
            out.append(Process(e, each, modes(e, each, r.windows)))
    return out


def _other_noise(
    r: Response, priors: Priors, choice: Choice, processes: Sequence[Process]
) -> tuple[list[dict[str, Columns]], list[dict[str, Columns]]]:
    """Without each process of a choice; and with another one in its place, or one more."""
    noise = dict(choice.noise)
    less = [{k: c for k, c in noise.items() if k != i} for i in noise]
    more = list(_one_more(r, priors, choice.names, noise, processes, EXACT))
    for rest in less:
        more += _one_more(r, priors, choice.names, rest, processes, 1)
    return less, more


def _one_more(
    r: Response,
    priors: Priors,
    names: frozenset[str],
    noise: dict[str, Columns],
    processes: Sequence[Process],
    most: int,
) -> Iterator[dict[str, Columns]]:
    """This noise and one process more beside these names, the likeliest by a look."""
    have = {_family(i) for i in (*noise, *(e.id for e in r.filtered))}
    looked: dict[str, tuple[float, Effect, Levels]] = {}
    for sensor in sorted(r.windows.sensors):
        mine = [p for p in processes if sensor_of(p.effect) == sensor]
        mine = [p for p in mine if _family(p.effect.id) not in have]
        if not mine:
            continue
        b, G = windows_beside(r, names, noise, sensor)
        for p in mine:
            nats, e, levels = _look(p, b, G)
            value = r.worth * nats + priors.of(e)
            likelier = value > looked.get(p.effect.id, (0.0,))[0]
            if likelier and e.id not in priors.refused and held(e, levels, r.windows):
                looked[p.effect.id] = value, e, levels
    for _, e, levels in sorted(looked.values(), key=lambda x: -x[0])[:most]:
        # (a look at each axis alone finds sizes that are too large for all of them together)
        for share in SMALLER:
            size = {e.levels[0].name: share * levels[0][e.levels[0].name]}
            yield {**noise, e.id: noise_columns(r, e, [{**own, **size} for own in levels])}


def _look(p: Process, b: Array, G: Array) -> tuple[float, Effect, Levels]:
    """Nats that a process gains at its best size on the axes where it gains, each axis alone; that
    process, and its levels."""
    size = p.effect.levels[0]
    sizes = np.clip(SIZES * size.initial, size.lower, size.upper) / size.initial
    nats = np.empty((len(b), len(sizes)))
    for a in range(len(b)):
        info, along = np.linalg.eigh(p.F.T @ G[a, :, a] @ p.F)
        told = (along.T @ (p.F.T @ b[a])) ** 2
        wide = 1.0 + sizes[:, None] ** 2 * np.maximum(info, 0.0)
        each = sizes[:, None] ** 2 * told / wide - np.log(wide)
        nats[a] = 0.5 * each.sum(axis=1)
    narrow = with_motion.is_with_motion(p.effect.id) and len(b) > 1
    whole = np.maximum(nats, 0.0).sum(axis=0) if narrow else nats.sum(axis=0)
    k = int(np.argmax(whole))
    axes = tuple(int(a) for a in np.flatnonzero(nats[:, k] > 0.0))
    e = with_motion.on_axes(p.effect, axes) if narrow and axes else p.effect
    values = [float(sizes[k] * size.initial), *list(p.levels[0].values())[1:]]
    levels = {lv.name: v for lv, v in zip(e.levels, values, strict=True)}
    return float(whole[k]), e, [levels] * len(p.levels)


def _family(effect_id: str) -> str:
    """Sensor and kind of a noise process, whatever its axes."""
    channel, _, kind = effect_id.partition(" += ")
    return f"{channel.partition('_')[0]} += {kind}" if kind else effect_id
