"""Laws that nobody named: the best of hundreds beside a model, and the formula that it has."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.estimate.beside import side_by_side
from handcal.estimate.fit import Fitted, Model, fitted, prior_root, scan
from handcal.estimate.quadratic import Quadratic
from handcal.explain import shapes, terms
from handcal.explain.drivers import DRIVERS, LINE, Driver, usable
from handcal.explain.grammar import (
    Form, Part, Range, about, curves, formula, parts_for, range_of,
)
from handcal.explain.laws import SIZE, Law, effect_of, named
from handcal.explain.score import TERM_PRIOR, better
from handcal.linear import path
from handcal.signals import of_recording
from handcal.types import Array, IntArray

# Columns that a scan looks at together, by the memory that they take.
AT_ONCE = 140
# Drivers that are looked at more closely, of the best.
CLOSER = 3
# A number of a formula is chosen from many: nats that it costs.
FREEDOM = shapes.FREEDOM
# Shares of the way to a formula's next numbers on trial at which it is tried once more, in turn.
FINER = (0.3, 0.08)
NO_INDEX: IntArray = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Term:
    """Something without a name, and the nats that it gains at the likelihood's full worth."""

    effect: Effect
    gain: float


@dataclass(frozen=True)
class Beside:
    """What a scan says of parameters that are not in the model, those of the model integrated
    out: b (m,), G (m, m), and the place of each effect's; worth: of the evidence."""

    b: Array
    G: Array
    at: dict[str, IntArray]
    worth: float

    def gain(self, b: Array, G: Array, root: Array) -> float:
        """Nats that parameters of such a quadratic gain; root (k, k): of their prior."""
        A = root.T @ G @ root
        A = 0.5 * (A + A.T) + np.eye(len(A))
        L = np.linalg.cholesky(A)
        y = np.linalg.solve(L, root.T @ b)
        return float(0.5 * y @ y - np.log(np.diag(L)).sum())


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
    return Beside(b, G, at, q.worth)


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
    over: Range
    forms: tuple[Form, ...]
    sigmas: tuple[float, ...]
    effect: Effect


def blocks(signals: Signals) -> list[Block]:
    """Every sensor with every driver of which this recording has a course."""
    out = []
    for driver in DRIVERS.values():
        if not usable(driver, signals):
            continue
        x = np.stack([driver.of(signals, axis) for axis in range(3)])
        rms = float(np.sqrt(np.mean(x**2)))
        if rms < 1e-9 or np.ptp(x) < 1e-6 * rms:
            continue
        over = range_of(x, driver.signed)
        for sensor, size in enumerate(SIZE):
            if driver.only not in (None, sensor):
                continue
            if driver.knots == LINE:
                forms, sigma = [formula([("line", ())])], size / rms
            else:
                forms, sigma = curves(over, driver.knots, driver.round), size
            sigmas = (sigma,) * forms[0].constants
            out.append(_block(sensor, driver, over, tuple(forms), sigmas))
    return out


def _block(
    sensor: int, driver: Driver, over: Range, forms: tuple[Form, ...], sigmas: tuple[float, ...]
) -> Block:
    law = Law(sensor, (0, 1, 2), True, driver, replace(forms[0], root=None), sigmas)
    effect = replace(effect_of(law), id=f"basis: {sensor} {driver.name}")
    return Block(sensor, driver, over, forms, sigmas, effect)


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
    for axes, each, b, G in _ways(block, seen):
        gains = []
        for form in block.forms:
            root = np.eye(form.constants) if form.root is None else form.root
            gains.append(seen.gain(b, G, np.kron(np.eye(len(b) // len(root)), root)))
        top = max(gains)
        form = block.forms[int(np.argmax(gains))]
        law = Law(block.sensor, axes, each, block.driver, form, block.sigmas)
        if form.smooth or not named(law):
            # (its width and size are not known: the mean over all)
            yield law, top + math.log(np.mean(np.exp(np.array(gains) - top)))


# --- formulas ------------------------------------------------------------------------------


def written_out(
    model: Model, known: Sequence[Effect], law: Law, over: Range, signals: Signals
) -> tuple[Law, float]:
    """The law as the formula that gains most over the model, and what it gains: of one function,
    or of two; with its numbers adjusted."""
    parts = parts_for(over, law.driver.signed, law.driver.round)
    tried = _tried(model, known, law, parts, signals)
    for share in FINER:
        if tried is None:
            break
        best, gain = tried
        finer = _tried(model, known, law, _finer(best.form, share), signals)
        if finer is not None and finer[1] > gain:
            tried = finer
    return tried if tried is not None else (law, -math.inf)


def _finer(form: Form, share: float) -> list[Part]:
    return [near for part in form.parts for near in about(part, share)]


def _tried(
    model: Model,
    known: Sequence[Effect],
    law: Law,
    parts: Sequence[Part],
    signals: Signals,
) -> tuple[Law, float] | None:
    """The best sum of one or two of these functions in the law's place."""
    forms = [formula([part]) for part in parts]
    sizes = [_rms(law, form, signals) for form in forms]
    some = [n for n, size in enumerate(sizes) if size > 1e-9]
    if not some:
        return None
    forms = [forms[n] for n in some]
    sigmas = [SIZE[law.sensor] / sizes[n] for n in some]
    effects = [
        replace(
            effect_of(replace(law, form=form, sigmas=(sigma,))), id=f"basis: {n}"
        )
        for n, (form, sigma) in enumerate(zip(forms, sigmas, strict=True))
    ]
    seen = beside(scan(model, effects), known, effects)
    cost = [FREEDOM * len(form.numbers) for form in forms]
    best: tuple[float, tuple[int, ...]] = (-math.inf, ())
    for chosen in _sets(len(forms)):
        at = np.concatenate([seen.at[f"basis: {n}"] for n in chosen])
        gain = seen.gain(seen.b[at], seen.G[np.ix_(at, at)], np.eye(len(at)))
        gain -= sum(cost[n] for n in chosen)
        if gain > best[0]:
            form = formula([forms[n].parts[0] for n in chosen])
            candidate = replace(law, form=form, sigmas=tuple(sigmas[n] for n in chosen))
            if not named(candidate):
                best = gain, chosen
                found = candidate
    return (found, best[0]) if best[1] else None


def _sets(count: int) -> Iterator[tuple[int, ...]]:
    for n in range(count):
        yield (n,)
    for n in range(count):
        for m in range(n + 1, count):
            yield n, m


def _rms(law: Law, form: Form, signals: Signals) -> float:
    values = [form.values(law.driver.of(signals, axis)) for axis in law.axes]
    return float(np.sqrt(np.mean(np.square(values))))


# --- the best of all -----------------------------------------------------------------------


def best_term(
    model: Model, *, imu: bool = True, refused: Collection[str] = (), without: str = ""
) -> Term | None:
    """What gains most over the model, if it gains enough: a law over a driver, or a course over
    time or direction. imu: False to look for one of the heading alone; refused: formulas with
    which no fit holds; without: an effect of the model in whose place it is looked for."""
    f = model.parts[0]
    signals, recording = signals_of(f), f.case.recording
    known = [e for e in model.effects if e.process is None and e.id != without]
    enough = -TERM_PRIOR + math.log(2.0)
    calls = [partial(_laws, model, known, chunk) for chunk in _chunks(signals if imu else None)]
    spans = [shapes.imu_basis(c, recording.duration_s) for c in range(6 if imu else 0)]
    calls += [partial(_courses, model, known, (), spans[n : n + 2]) for n in range(0, len(spans), 2)]
    if "heading" in f.case.kinds:
        bases = shapes.heading_bases(recording.duration_s)
        calls.append(partial(_courses, model, known, terms.heading_terms(recording), bases))
    ends = [end for some in side_by_side(calls) for end in some if end[1] > enough]
    laws = _closer([e for e in ends if isinstance(e[0], Law)])
    out = [Term(e[0], e[2]) for e in ends if isinstance(e[0], Effect)]
    for law, gain, full in laws:
        over = range_of(_of(law, signals), law.driver.signed)
        other, better_ = written_out(model, known, law, over, signals)
        out.append(Term(effect_of(law), full))
        if better_ >= gain:
            out.append(Term(effect_of(other), better_ * full / gain))
    out = [t for t in out if t.effect.id not in refused]
    return max(out, key=lambda t: t.gain, default=None)


def _closer(ends: Sequence[End]) -> list[tuple[Law, float, float]]:
    """The best laws, each of another driver."""
    best: dict[tuple[int, str], tuple[Law, float, float]] = {}
    for law, gain, full in sorted(ends, key=lambda e: -e[2]):
        if isinstance(law, Law):
            best.setdefault((law.sensor, law.driver.name), (law, gain, full))
    return list(best.values())[:CLOSER]


def _of(law: Law, signals: Signals) -> Array:
    return np.stack([law.driver.of(signals, axis) for axis in range(3)])


def _chunks(signals: Signals | None) -> Iterator[list[Block]]:
    """All blocks, as many together as a scan may look at."""
    chunk: list[Block] = []
    size = 0
    for block in blocks(signals) if signals is not None else ():
        if chunk and size + len(block.effect.parameters) > AT_ONCE:
            yield chunk
            chunk, size = [], 0
        chunk.append(block)
        size += len(block.effect.parameters)
    if chunk:
        yield chunk


End = tuple[Law | Effect, float, float]


def _laws(model: Model, known: Sequence[Effect], chunk: Sequence[Block]) -> list[End]:
    """The laws of these blocks, what each gains, and the same at the likelihood's full worth."""
    effects = [b.effect for b in chunk]
    seen = beside(scan(model, effects), known, effects)
    ends = [end for b in chunk for end in _of_block(b, seen)]
    return [(law, gain, gain / seen.worth) for law, gain in ends]


def _courses(
    model: Model,
    known: Sequence[Effect],
    chunk: Sequence[Effect],
    bases: Sequence[shapes.Basis],
) -> list[End]:
    """Terms, and the best course over each of these bases; what each gains."""
    here = {e.id for e in model.effects}
    chunk = [e for e in chunk if e.id not in here]
    q = scan(model, [*chunk, *(b.effect for b in bases)])
    seen = beside(q, known, chunk)
    out: list[End] = []
    for e in chunk:
        at = seen.at[e.id]
        gain = seen.gain(seen.b[at], seen.G[np.ix_(at, at)], np.eye(len(at)))
        out.append((e, gain, gain / q.worth))
    ids = {e.id for e in known}
    index: IntArray = np.array([i for i, n in enumerate(q.names) if n[0] in ids], dtype=np.int64)
    for basis in bases:
        course, gain = shapes.best(basis, q, index, wide_root(q, known, index))
        out.append((course, gain, gain / q.worth))
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
        if new is None or new.effect.id in shaped | set(model.ids):
            continue
        tried = fitted(model.parts, [new.effect if e is old else e for e in model.effects])
        if better(tried, model, worth) > 0.0:
            unnamed[i] = new
            return tried
    return None


def signals_of(f: Fitted) -> Signals:
    """The best estimate of rate, force and attitude at the IMU's samples."""
    imu, nominal = f.case.recording.imu, f.linear.trajectory
    read = np.hstack([imu.gyro - nominal.bg, imu.accel - nominal.ba])
    C_nb = None
    if f.linear.problem.navigated:
        problem = f.linear.problem
        C_nb = path(problem, nominal).C[np.searchsorted(problem.nodes.t, imu.t)]
    return of_recording(f.case.recording, read=read, C_nb=C_nb)
