"""Laws that nobody named: the best of hundreds beside a model, and the formula that it has."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from handcal.effects import Effect, Signals
from handcal.estimate.beside import side_by_side
from handcal.estimate.columns import Ground
from handcal.estimate.fit import fitted, grounds, prior_root, scan
from handcal.estimate.model import Fitted, Model
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.trajectory import path
from handcal.explain.score import TERM_PRIOR, better, score
from handcal.explain.unnamed import shapes, terms
from handcal.explain.unnamed.drivers import DRIVERS, LINE, NEARER, Driver, usable
from handcal.explain.unnamed.grammar import (
    Form,
    Part,
    about,
    cost_of,
    curves,
    formula,
    parts_for,
    range_of,
)
from handcal.explain.unnamed.laws import SIZE, Law, effect_of, law_of, named
from handcal.signals import of_recording
from handcal.types import Array, IntArray

# Columns that a scan looks at together at the most and at the least, and numbers that all of them
# may take, some thirty for each epoch: 150 MB.
MOST_COLUMNS, LEAST_COLUMNS = 140, 30
NUMBERS, PER_EPOCH = 2e7, 30.0
# Drivers that are looked at more closely, of the best.
CLOSER = 3
# Of what a law gains, the share that terms of second order leave open: a formula that costs more
# than the one there is has to gain more than that.
OPEN = 1e-3
# Shares of the way to a formula's next numbers on trial at which it is tried once more, in turn.
FINER = (0.5, 0.2, 0.06)


@dataclass(frozen=True)
class Term:
    """Something without a name, and the nats that it gains at the likelihood's full worth;
    others: the same law in other forms, which a scan likes less."""

    effect: Effect
    gain: float
    others: tuple[Effect, ...] = ()


@dataclass(frozen=True)
class Beside:
    """What a scan says of parameters that are not in the model, those of the model integrated
    out: b (m,), G (m, m), and the place of each effect's."""

    b: Array
    G: Array
    at: dict[str, IntArray]

    def gains(self, index: IntArray) -> Array:
        """Nats (f,) that each of several sets of parameters (f, k) gains under their priors."""
        return gains(self.b[index], self.G[index[:, :, None], index[:, None]])


def gains(b: Array, G: Array, root: Array | None = None) -> Array:
    """Nats (f,) that parameters of such quadratics, b (f, k) and G (f, k, k), gain; root
    (f, k, k): of their priors (None: the identity)."""
    if root is not None:
        back = root.transpose(0, 2, 1)
        b, G = np.einsum("fij,fj->fi", back, b), back @ G @ root
    A = 0.5 * (G + G.transpose(0, 2, 1)) + np.eye(b.shape[1])
    L = np.linalg.cholesky(A)
    y = np.linalg.solve(L, b[:, :, None])[:, :, 0]
    return np.asarray(0.5 * (y**2).sum(axis=1) - np.log(np.einsum("fii->fi", L)).sum(axis=1))


def beside(q: Quadratic, known: Sequence[Effect], absent: Sequence[Effect]) -> Beside:
    """The quadratic of the parameters of absent effects beside those of known ones."""
    where: dict[str, list[int]] = {e.id: [] for e in (*known, *absent)}
    for i, (owner, _) in enumerate(q.names):
        if owner in where:
            where[owner].append(i)
    index: IntArray = np.array([i for e in known for i in where[e.id]], dtype=np.int64)
    mine: IntArray = np.array([i for e in absent for i in where[e.id]], dtype=np.int64)
    b, G = shapes.integrated(q, mine, index, wide_root(q, known, index))
    at, first = {}, 0
    for e in absent:
        at[e.id] = np.arange(first, first + len(where[e.id]), dtype=np.int64)
        first += len(where[e.id])
    return Beside(b, G, at)


def weighed(q: Quadratic, worth: float) -> Quadratic:
    """The quadratic with its evidence counting for so much: all that is compared, for the same."""
    share = worth / q.worth
    return replace(q, b=share * q.b, G=share * q.G, worth=worth)


def wide_root(q: Quadratic, known: Sequence[Effect], index: IntArray) -> Array:
    """Square root of the prior covariance of what is in the model, as wide as it is large: what
    stands out of its prior may not be relieved by something else."""
    root = prior_root(q, known, index)
    if not len(index):
        return np.zeros((0, 0))
    root = np.eye(len(index)) if root is None else root
    b, G = q.b[index], q.G[np.ix_(index, index)]
    u = np.linalg.lstsq(G + 1e-6 * np.eye(len(b)), b, rcond=None)[0]
    return np.asarray(np.maximum(1.0, np.abs(u))[:, None] * root)


# --- laws over drivers ---------------------------------------------------------------------


@dataclass(frozen=True)
class Block:
    """All laws of one sensor over one driver, as one effect of each axis's coefficients."""

    sensor: int
    driver: Driver
    forms: tuple[Form, ...]
    sigmas: tuple[float, ...]
    effect: Effect


def blocks(signals: Signals) -> list[Block]:
    """Every sensor with every driver of which this recording has a course."""
    return [b for d in DRIVERS.values() if usable(d, signals) for b in _over(d, signals)]


def _over(driver: Driver, signals: Signals) -> list[Block]:
    x = np.stack([driver.of(signals, axis) for axis in range(3)])
    rms = float(np.sqrt(np.mean(x**2)))
    if rms < 1e-9 or np.ptp(x) < 1e-6 * rms:
        return []
    sensors = [n for n in range(len(SIZE)) if driver.only in (None, n)]
    if driver.knots == LINE:
        forms = (formula([("line", ())]),)
        return [_block(n, driver, forms, SIZE[n] / rms) for n in sensors]
    smooth = tuple(curves(range_of(x, driver.signed), driver.knots, driver.round))
    return [_block(n, driver, smooth, SIZE[n]) for n in sensors]


def _block(sensor: int, driver: Driver, forms: tuple[Form, ...], sigma: float) -> Block:
    sigmas = (sigma,) * forms[0].constants
    law = Law(sensor, (0, 1, 2), True, driver, replace(forms[0], root=None), sigmas)
    effect = replace(effect_of(law), id=f"basis: {sensor} {driver.name}")
    return Block(sensor, driver, forms, sigmas, effect)


def _ways(block: Block, seen: Beside) -> Iterator[tuple[tuple[int, ...], bool, Array, Array]]:
    """Axes, whether each has its own constants, and the quadratic of these: each axis alone, and
    all by one law."""
    at = seen.at[block.effect.id].reshape(3, -1)
    b, G = seen.b[at], seen.G[at[:, :, None, None], at[None, None]]
    for axis in range(3):
        yield (axis,), False, b[axis], G[axis, :, axis]
    if block.driver.own:
        yield (0, 1, 2), False, b.sum(axis=0), G.sum(axis=(0, 2))
        yield (0, 1, 2), True, b.ravel(), G.reshape(b.size, b.size)


def _of_block(block: Block, seen: Beside) -> Iterator[tuple[Law, float]]:
    """The best law of each way, and what it gains."""
    one = block.forms[0].constants
    roots = np.stack([np.eye(one) if f.root is None else f.root for f in block.forms])
    for axes, each, b, G in _ways(block, seen):
        own = len(b) // one
        whole = np.zeros((len(roots), own, one, own, one))
        for n in range(own):
            whole[:, n, :, n] = roots
        many = len(roots), len(b), len(b)
        found = gains(np.broadcast_to(b, many[:2]), np.broadcast_to(G, many), whole.reshape(many))
        top = float(found.max())
        form = block.forms[int(np.argmax(found))]
        law = Law(block.sensor, axes, each, block.driver, form, block.sigmas)
        if form.smooth or not named(law):
            # (its width and size are not known: the mean over all)
            yield law, top + math.log(np.mean(np.exp(found - top)))


# --- formulas ------------------------------------------------------------------------------


@dataclass(frozen=True)
class About:
    """Where laws are weighed: about a model (``grounds`` for its scans), beside its known effects,
    with the signals of its first recording, and what evidence is worth."""

    model: Model
    grounds: Sequence[Ground]
    known: Sequence[Effect]
    signals: Signals
    worth: float

    def seen(self, absent: Sequence[Effect]) -> Beside:
        """What a scan says of absent effects."""
        q = scan(self.model, absent, self.grounds)
        return beside(weighed(q, self.worth), self.known, absent)


def written_out(about_: About, law: Law) -> list[tuple[Law, float]]:
    """The law as the formulas that gain most over the model, and what they gain: of one function,
    and of two; with their numbers adjusted."""
    driver = law.driver
    x = np.stack([driver.of(about_.signals, axis) for axis in range(3)])
    over = range_of(x, driver.signed)
    parts = parts_for(over, driver.signed, driver.round)
    return [_adjusted(about_, *end) for end in _tried(about_, law, parts)]


def _adjusted(about_: About, law: Law, gain: float) -> tuple[Law, float]:
    """The formula with the numbers near its own that gain most, and what it gains."""
    for share in FINER if law.form.numbers else ():
        parts = [near for part in law.form.parts for near in about(part, share)]
        for other, value in _tried(about_, law, parts):
            if value > gain and len(other.form.parts) == len(law.form.parts):
                law, gain = other, value
    return law, gain


def _tried(about_: About, law: Law, parts: Sequence[Part]) -> list[tuple[Law, float]]:
    """The best of these functions in the law's place, and the best sum of two; what they gain."""
    forms = [formula([part]) for part in parts]
    sizes = np.array([_rms(law, form, about_.signals) for form in forms])
    some = np.flatnonzero(sizes > 1e-9)
    effects = [
        replace(
            effect_of(replace(law, form=forms[n], sigmas=(SIZE[law.sensor] / sizes[n],))),
            id=f"basis: {n}",
        )
        for n in some
    ]
    seen = about_.seen(effects)
    out = []
    for sets in _sets([int(n) for n in some], parts):
        index = [np.concatenate([seen.at[f"basis: {n}"] for n in chosen]) for chosen in sets]
        values = seen.gains(np.array(index)) - [cost_of([parts[n] for n in s]) for s in sets]
        for k in np.argsort(-values, kind="stable"):
            sigmas = tuple(float(SIZE[law.sensor] / sizes[n]) for n in sets[k])
            form = formula([parts[n] for n in sets[k]])
            candidate = replace(law, form=form, sigmas=sigmas)
            if not named(candidate):
                out.append((candidate, float(values[k])))
                break
    return out


def _sets(some: Sequence[int], parts: Sequence[Part]) -> list[list[tuple[int, ...]]]:
    """All of one of these, and all of two that are different functions."""
    one: list[tuple[int, ...]] = [(n,) for n in some]
    two: list[tuple[int, ...]] = [
        (n, m) for n, m in combinations(some, 2) if parts[n][0] != parts[m][0]
    ]
    return [sets for sets in (one, two) if sets]


def tuned(about_: About, law: Law, gain: float) -> tuple[Law, float]:
    """The law with the time or half width of its driver that gains most, and what it gains."""
    for shares in NEARER:
        at, number = law.driver.at, law.driver.number
        if at is None:
            break
        near = [b for s in shares for b in _over(at(s * number), about_.signals)]
        near = [b for b in near if b.sensor == law.sensor]
        seen = about_.seen([b.effect for b in near])
        for other, value in (end for block in near for end in _of_block(block, seen)):
            if value > gain and (other.axes, other.each) == (law.axes, law.each):
                law, gain = other, value
    return law, gain


def _rms(law: Law, form: Form, signals: Signals) -> float:
    values = [form.values(law.driver.of(signals, axis)) for axis in law.axes]
    return float(np.sqrt(np.mean(np.square(values))))


# --- the best of all -----------------------------------------------------------------------


def best_term(model: Model, *, refused: Collection[str] = (), without: str = "") -> Term | None:
    """What gains most over the model, if it gains enough: a law over a driver, or a course over
    time or direction. refused: formulas with which no fit holds; without: an effect of the model
    in whose place it is looked for."""
    f = model.parts[0]
    signals = signals_of(f)
    known = [e for e in model.effects if e.process is None and e.id != without]
    looks = list(_looks(f, signals, known))
    base = grounds(model)
    scans = list(side_by_side(partial(scan, model, look.effects, base) for look in looks))
    # (what is absent scatters differently from scan to scan: one worth for all)
    worth = float(np.median([q.worth for q in scans]))
    enough = -TERM_PRIOR + math.log(2.0)
    ends = [
        end
        for look, q in zip(looks, scans, strict=True)
        for end in look.best(weighed(q, worth), known)
        if end[1] > enough
    ]
    about_ = About(model, base, known, signals, worth)
    found = [Term(e, gain / worth) for e, gain in ends if isinstance(e, Effect)]
    found += [_as_told(about_, law, gain) for law, gain in _closer(ends)]
    found = [t for t in found if t.effect.id not in refused]
    return max(found, key=lambda t: t.gain, default=None)


def _as_told(about_: About, law: Law, gain: float) -> Term:
    """The law in the form that gains most, a formula where it gains as much as the curve."""
    if law.driver.number:
        law, gain = tuned(about_, law, gain)
        gain -= law.cost
    ends = written_out(about_, law) if law.form.smooth else []
    ends = sorted([*ends, (law, gain)], key=lambda end: -end[1])
    first, *others = (effect_of(x) for x, _ in ends)
    return Term(first, ends[0][1] / about_.worth, tuple(others))


End = tuple[Law | Effect, float]


@dataclass(frozen=True)
class Look:
    """What one scan looks at, and the best that it may show, beside the known effects."""

    effects: Sequence[Effect]
    best: Callable[[Quadratic, Sequence[Effect]], list[End]]


def _looks(f: Fitted, signals: Signals, known: Sequence[Effect]) -> Iterator[Look]:
    """All scans: laws over drivers, courses over time, and those of a heading."""
    recording = f.case.recording
    room = NUMBERS / (PER_EPOCH * len(f.linear.t))
    for chunk in _chunks(signals, int(min(max(room, LEAST_COLUMNS), MOST_COLUMNS))):
        yield Look([b.effect for b in chunk], partial(_laws, chunk))
    for first in range(0, 6, 2):
        spans = [shapes.imu_basis(first + n, recording.duration_s) for n in range(2)]
        yield Look([b.effect for b in spans], partial(_courses, spans))
    if "heading" in f.case.kinds:
        here = {e.id for e in known}
        options = [[e] for e in terms.heading_terms(recording)] + terms.heading_curves()
        options = [some for some in options if some[0].id not in here]
        # (each as something to look at: what the model has of it is another matter)
        looked = [replace(some[0], id=f"basis: {n}") for n, some in enumerate(options)]
        yield Look(looked, partial(_headings, looked, options))
        bases = shapes.heading_bases(recording.duration_s)
        yield Look([b.effect for b in bases], partial(_courses, bases))


def _chunks(signals: Signals, most: int) -> Iterator[list[Block]]:
    """All blocks, together in scans of so many columns at the most."""
    chunk: list[Block] = []
    size = 0
    for block in blocks(signals):
        if chunk and size + len(block.effect.parameters) > most:
            yield chunk
            chunk, size = [], 0
        chunk.append(block)
        size += len(block.effect.parameters)
    if chunk:
        yield chunk


def _laws(chunk: Sequence[Block], q: Quadratic, known: Sequence[Effect]) -> list[End]:
    seen = beside(q, known, [b.effect for b in chunk])
    return [end for b in chunk for end in _of_block(b, seen)]


def _closer(ends: Sequence[End]) -> list[tuple[Law, float]]:
    """The best laws, each of another driver."""
    best: dict[tuple[int, str], tuple[Law, float]] = {}
    for law, gain in sorted(ends, key=lambda e: -e[1]):
        if isinstance(law, Law):
            best.setdefault((law.sensor, law.driver.name), (law, gain))
    return list(best.values())[:CLOSER]


def _courses(bases: Sequence[shapes.Basis], q: Quadratic, known: Sequence[Effect]) -> list[End]:
    ids = {e.id for e in known}
    index: IntArray = np.array([i for i, n in enumerate(q.names) if n[0] in ids], dtype=np.int64)
    return [shapes.best(b, q, index, wide_root(q, known, index)) for b in bases]


def _headings(
    looked: Sequence[Effect],
    options: Sequence[Sequence[Effect]],
    q: Quadratic,
    known: Sequence[Effect],
) -> list[End]:
    """Terms and curves of the heading, and what each gains."""
    seen = beside(q, known, looked)
    out: list[End] = []
    for e, some in zip(looked, options, strict=True):
        at = seen.at[e.id]
        b, G = seen.b[at], seen.G[np.ix_(at, at)]
        roots = np.stack([np.eye(len(at)) if x.together is None else x.together for x in some])
        many = len(roots), len(at), len(at)
        found = gains(np.broadcast_to(b, many[:2]), np.broadcast_to(G, many), roots)
        gain = float(found.max() + math.log(np.mean(np.exp(found - found.max()))))
        out.append((some[int(np.argmax(found))], gain))
    return out


def reshaped(model: Model, worth: float, unnamed: list[Term], shaped: set[str]) -> Model | None:
    """The model with a law or course that fits better than the one it has, which was chosen when
    less was known; ``unnamed`` is changed with it."""
    for i, term in enumerate(unnamed):
        old = term.effect
        if old.id not in model.ids or old.id in shaped:
            continue
        shaped.add(old.id)
        new = best_term(model, without=old.id)
        if new is None:
            continue
        options = [e for e in (new.effect, *new.others) if e.id not in shaped | set(model.ids)]
        calls = (partial(_with, model, old, e) for e in options)
        pairs = zip(side_by_side(calls), options, strict=True)
        held = [
            (m, e)
            for m, e in pairs
            if better(m, model, worth) > (OPEN * worth * new.gain if _cost(e) > _cost(old) else 0.0)
        ]
        if not held:
            continue
        best, effect = max(held, key=lambda pair: score(pair[0], worth))
        unnamed[i] = Term(effect, new.gain)
        if _kind(effect) == _kind(old):
            shaped.add(effect.id)  # (its numbers are as good as they get)
        return best
    return None


def _cost(effect: Effect) -> float:
    law = law_of(effect)
    return 0.0 if law is None or law.form.smooth else law.cost


def _with(model: Model, old: Effect, new: Effect) -> Model:
    return fitted(model.parts, [new if e is old else e for e in model.effects])


def _kind(effect: Effect) -> tuple[str, ...]:
    """What something without a name is, but for its numbers."""
    law = law_of(effect)
    if law is not None:
        return effect.id.split(" += ")[0], law.driver.kind, law.form.kind
    return (effect.id if effect.made is None else effect.made[0],)


def signals_of(f: Fitted) -> Signals:
    """The best estimate of rate, force and attitude at the IMU's samples."""
    imu, nominal = f.case.recording.imu, f.linear.trajectory
    read = np.hstack([imu.gyro - nominal.bg, imu.accel - nominal.ba])
    C_nb = None
    if f.linear.problem.navigated:
        problem = f.linear.problem
        C_nb = path(problem, nominal).C[np.searchsorted(problem.nodes.t, imu.t)]
    return of_recording(f.case.recording, read=read, C_nb=C_nb)
