"""Laws without a name by the matrix of a fit: every driver as its means in short windows.

A law over a driver is a product with the matrix, so thousands of them are weighed beside any names
and noise, and in their place, without another pass of the filter. What is proposed here a fit
decides on.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from handcal.effects import Effect, Signals
from handcal.estimate.model import Model
from handcal.estimate.prior_root import root_of
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.scan import grounds, scan
from handcal.estimate.transfer import without
from handcal.laws import shapes
from handcal.laws.compositions import composed, composed_headings
from handcal.laws.drivers import DRIVERS, HEADING, Driver, usable
from handcal.laws.grammar import FREEDOM, formula
from handcal.laws.law_effect import AXES_OF, SENSORS, Law, effect_of, law_of
from handcal.laws.over_drivers import About, best_of_block, over, tuned, written_out
from handcal.laws.short_windows import Courses, courses_of, fits_in, gains_of, means
from handcal.laws.terms import CURVE
from handcal.laws.vocabulary import CURVED, further
from handcal.laws.weighing import Beside, beside, gains, wide_root
from handcal.model_score import TERM_PRIOR
from handcal.search.response import Response, Windows, sensor_of
from handcal.search.select import Choice, Priors, chosen, windows_beside
from handcal.types import Array, IntArray

# Drivers of a sensor that are looked at as formulas, the likeliest of all and of those that
# are no composition.
CLOSER, PLAIN = 4, 3
# Nats that a driver gains from which it is looked at: a formula gains some eight more.
LEAST = -TERM_PRIOR - 8.0
# Nats below the best law of a sensor within which one is its rival.
NEAR = 10.0
# Names that gain less may stand in for a law.
WEAK = 100.0
# A curve is written out as formulas if its score, and this share of its gain more, comes within so
# many nats of the best: knots are too few for what is sharp, and a fit may gain more.
SHARP, WITHIN = 0.1, 50.0


@dataclass(frozen=True, eq=False)
class Found:
    """A law as an effect; beside: the choice it is added to; go: ids whose place it takes; nats:
    that it gains; score: of both."""

    effect: Effect
    beside: Choice
    go: frozenset[str]
    nats: float
    score: float


@dataclass(frozen=True, eq=False)
class InWindows:
    """Laws of a sensor weighed from windows of all recordings, beside what is known; signals: of
    the first recording."""

    whole: Beside
    windows: Windows
    sensor: int

    @property
    def signals(self) -> Signals:
        return self.windows.seldom[0][0]

    def seen(self, absent: Sequence[Effect]) -> Beside:
        """The quadratic of effects that act on this sensor only."""
        C = np.hstack([np.zeros((len(self.whole.b), 0)), *(self._means(e) for e in absent)])
        ends = np.cumsum([0, *(len(e.parameters) for e in absent)])
        at = {e.id: np.arange(*ends[n : n + 2]) for n, e in enumerate(absent)}
        return Beside(C.T @ self.whole.b, C.T @ self.whole.G @ C, at)

    def _means(self, e: Effect) -> Array:
        """Mean errors (axes * N, k) in all windows."""
        axes, k = len(AXES_OF[self.sensor]), len(e.parameters)
        parts = [
            means(e, self.sensor, *seen, w.count).reshape(axes, -1, k)
            for w, seen in zip(self.windows.each, self.windows.seldom, strict=True)
        ]
        return np.concatenate(parts, axis=1).reshape(-1, k)


def courses_on(windows: Windows) -> dict[int, list[Courses]]:
    """The courses of all drivers of each sensor, in the windows of all recordings."""
    sensors = sorted(windows.sensors)
    by_name = {
        k: {d.name: d for d in _drivers(windows.motion, k) if d.only in (None, k)} for k in sensors
    }
    # (the means of a driver are the same for both sensors of an IMU)
    imu = {name: d for k in sensors if k != HEADING for name, d in by_name[k].items()}
    out = {}
    if imu:
        both = _over_all(list(imu.values()), windows, 0)
        out = {k: [_some(c, by_name[k]) for c in both] for k in sensors if k != HEADING}
    if HEADING in by_name:
        out[HEADING] = _over_all(list(by_name[HEADING].values()), windows, HEADING)
    return out


def _over_all(drivers: Sequence[Driver], windows: Windows, sensor: int) -> list[Courses]:
    """Courses in the windows of all recordings, of drivers that vary in each of them."""
    each = [
        courses_of(drivers, s, sensor, w.count, w.of)
        for w, s in zip(windows.each, windows.motion, strict=True)
    ]
    first, *others = each
    out = []
    for of in first:
        same = [next((c for c in other if _alike(c, of)), None) for other in others]
        if any(c is None for c in same):
            continue
        rest = [c for c in same if c is not None]
        names = [{d.name: n for n, d in enumerate(c.drivers)} for c in rest]
        mine = [n for n, d in enumerate(of.drivers) if all(d.name in own for own in names)]
        several = [of.means[mine]]
        for c, own in zip(rest, names, strict=True):
            several.append(c.means[[own[of.drivers[n].name] for n in mine]])
        if mine:
            both = np.concatenate(several, axis=3)
            out.append(Courses([of.drivers[n] for n in mine], both, of.roots))
    return out


def _alike(a: Courses, b: Courses) -> bool:
    """Whether two are of one kind of law."""
    one, other = a.drivers[0], b.drivers[0]
    return (one.knots, one.round) == (other.knots, other.round)


def _drivers(motion: Sequence[Signals], sensor: int) -> list[Driver]:
    signals = motion[0]
    known = CURVED if sensor == HEADING else DRIVERS
    usual = [d for d in known.values() if usable(d, signals)]
    many = composed_headings(signals) if sensor == HEADING else composed(signals)
    return [*usual, *further(signals, sensor), *(many if all(map(fits_in, motion)) else ())]


def _some(of: Courses, names: Container[str]) -> Courses:
    """The courses of drivers of these names."""
    at = [n for n, d in enumerate(of.drivers) if d.name in names]
    return Courses([of.drivers[n] for n in at], of.means[at], of.roots)


def laws_of(
    r: Response,
    priors: Priors,
    choice: Choice,
    sensor: int,
    courses: Sequence[Courses],
    spared: Sequence[Effect] = (),
) -> Iterator[Found]:
    """Laws of a sensor beside a choice, or in the place of what may stand in for them, and formulas
    for the best curves; spared: noise that was in the filter and is not in this matrix."""
    gained = -sum(map(priors.of, spared))

    def found(other: Choice, e: Effect, nats: float) -> Found:
        go = (choice.ids - other.ids).union(x.id for x in spared)
        return Found(e, other, go, nats, other.score + gained + nats + priors.of(e))

    ends: list[tuple[Found, InWindows]] = []
    for other in _bases(r, priors, choice, sensor):
        b, G = windows_beside(r, other.names, other.noise, sensor)
        at = {str(a): x for a, x in enumerate(np.arange(b.size).reshape(b.shape))}
        b, G = r.worth * b.ravel(), r.worth * G.reshape(b.size, b.size)
        looked = InWindows(Beside(b, G, at), r.windows, sensor)
        ends += [(found(other, *end), looked) for end in _ends(r, other, looked, courses)]
    top = max([choice.score, *(f.score for f, _ in ends)])
    for f, looked in ends:
        forms = [(f.effect, f.nats)]
        law = law_of(f.effect)
        if law and law.form.smooth and f.score + SHARP * f.nats > top - WITHIN:
            forms += [(effect_of(x), v + x.form.cost) for x, v in written_out(looked, law, looked)]
        for e, nats in forms:
            if e.id not in {*priors.refused, *choice.names}:
                yield found(f.beside, e, nats)


def _ends(
    r: Response, beside: Choice, looked: InWindows, of: Sequence[Courses]
) -> Iterator[tuple[Effect, float]]:
    """Laws, courses, and terms of a heading, with what they gain, their costs unpaid."""
    for law, nats in _laws(looked, of):
        yield effect_of(law), nats
    if looked.sensor == HEADING:
        ends = list(_of_heading(r, beside))
        yield from ends
        yield from _formulas(r, beside, looked, ends)
    elif len(looked.windows.each) == 1:
        for e, nats in _courses(looked):
            yield e, nats + FREEDOM + e.cost


def _courses(looked: InWindows) -> Iterator[tuple[Effect, float]]:
    """Courses of an IMU's sensor over time, less their costs."""
    (signals,) = looked.windows.motion
    duration = float(signals.t[-1] - signals.t[0])
    for axis in range(3):
        basis = shapes.imu_basis(3 * looked.sensor + axis, duration)
        seen = looked.seen([basis.effect])
        names = tuple((basis.effect.id, p.name) for p in basis.effect.parameters)
        nothing = np.zeros(0, dtype=np.int64)
        yield from shapes.closest(basis, Quadratic(names, 0.0, seen.b, seen.G), nothing)


def _of_heading(r: Response, choice: Choice) -> Iterator[tuple[Effect, float]]:
    """Terms, curves and courses of a heading, with what they gain, their costs unpaid."""
    known = [e for e in r.effects if e.id in choice.names]
    absent = [replace(some[0], id=i) for i, some in r.heading.items()]
    q = r.quadratic
    q = replace(q, b=r.worth * q.b, G=r.worth * q.G, worth=r.worth)
    seen = beside(q, known, absent)
    for i, some in r.heading.items():
        at = seen.at[i]
        b, G = seen.b[at], seen.G[np.ix_(at, at)]
        roots = np.stack([np.eye(len(at)) if x.together is None else x.together for x in some])
        many = len(roots), len(at), len(at)
        found = gains(np.broadcast_to(b, many[:2]), np.broadcast_to(G, many), roots)
        best = some[int(np.argmax(found))]
        yield best, float(found.max() + np.log(np.mean(np.exp(found - found.max()))))
    ids = {e.id for e in known}
    index: IntArray = np.array([n for n, (i, _) in enumerate(q.names) if i in ids], dtype=np.int64)
    root = wide_root(q, known, index)
    for basis in r.bases:
        for e, nats in shapes.closest(basis, q, index, root):
            yield e, nats + FREEDOM + e.cost


def _formulas(
    r: Response, choice: Choice, looked: InWindows, ends: Sequence[tuple[Effect, float]]
) -> Iterator[tuple[Effect, float]]:
    """Formulas for the best curve of a heading, evaluated by a scan: a heading may err in less than
    a window."""
    curves = [(nats, driver) for e, nats in ends if (driver := _curved(e)) and nats > LEAST]
    for _, driver in sorted(curves, key=lambda x: -x[0])[:1]:
        law = Law(HEADING, (0,), False, driver, formula([("line", ())]), (1.0,))
        known = [e for e in r.effects if e.id in choice.names]
        about = About(r.model, grounds(r.model), known, looked.signals, r.worth)
        for form, nats in written_out(about, law, looked):
            yield effect_of(form), nats + form.form.cost


def _curved(effect: Effect) -> Driver | None:
    """The driver of a curve of a heading; None for other effects."""
    kind = "" if effect.made is None else effect.made[0]
    return CURVED.get(kind.removeprefix(CURVE)) if kind.startswith(CURVE) else None


def groups_of(laws: Iterable[Found]) -> Iterator[list[Found]]:
    """The best of these, the next one, the best plain one and the one of least cost, all near the
    best; and so on of the rest."""
    best: dict[str, Found] = {}
    for law in sorted(laws, key=lambda f: -f.score):
        best.setdefault(law.effect.id, law)
    found = list(best.values())
    while found:
        forms = ((f, law_of(f.effect)) for f in found)
        plain = [f for f, law in forms if law is None or not law.driver.composed]
        near = [f for f in found if f.score > found[0].score - NEAR]
        group = [
            *near[:2],
            *(f for f in plain[:1] if f in near),
            min(near, key=lambda f: f.effect.cost),
        ]
        group = list({f.effect.id: f for f in group}.values())
        found = [f for f in found if f not in group]
        yield group


def _bases(r: Response, priors: Priors, choice: Choice, sensor: int) -> Iterator[Choice]:
    """A choice, and without what may stand in for a law of a sensor: its noise, weak names as well,
    all rare names and laws of the sensor as well, and each of its laws."""
    own = SENSORS[sensor]
    score = choice.where.score
    rest = {i: c for i, c in choice.noise.items() if sensor_of(c.effect) != sensor}
    spare = choice.names - priors.always
    weak = {i for i in spare if score(choice.names) - score(choice.names - {i}) < WEAK}
    mine = {i for i in spare if i.startswith(own)}
    laws = {i for i in mine if "+=" in i}
    ways = (
        (frozenset[str](), choice.noise),
        (frozenset[str](), rest),
        (weak, rest),
        (weak | mine, rest),
        *(({i}, rest) for i in sorted(laws)),
    )
    done = set()
    for gone, noise in ways:
        key = frozenset(gone), frozenset(noise)
        if key not in done:
            done.add(key)
            if not gone and len(noise) == len(choice.noise):
                yield choice
            else:
                yield chosen(r, priors, choice.names - gone, noise, choice.steps)


def _laws(looked: InWindows, courses: Sequence[Courses]) -> Iterator[tuple[Law, float]]:
    """The likeliest laws over each driver, with what they gain, their costs unpaid."""
    ranked = sorted(
        (
            (float(nats), driver)
            for of in courses
            for nats, driver in zip(gains_of(of, looked.whole), of.drivers, strict=True)
            if nats > LEAST
        ),
        key=lambda x: -x[0],
    )
    plain = [d for _, d in ranked if not d.composed]
    for driver in _each_kind([*(d for _, d in ranked)], CLOSER) | _each_kind(plain, PLAIN):
        for block in over(driver, looked.signals, (looked.sensor,)):
            ends = list(best_of_block(block, looked.seen([block.effect])))
            for law, nats in sorted(ends, key=lambda end: -end[1])[:1]:
                if law.driver.number:
                    law, nats = tuned(looked, law, nats)
                yield law, nats


def _each_kind(drivers: Sequence[Driver], most: int) -> dict[Driver, None]:
    """The first of these, each of another kind."""
    firsts: dict[str, Driver] = {}
    for driver in drivers:
        firsts.setdefault(driver.kind, driver)
        if len(firsts) == most:
            break
    return dict.fromkeys(firsts.values())


def confirmed(model: Model, found: Found, worth: float) -> float:
    """Nats that a law gains by a scan of its own beside the names of a choice.

    (Of what is nearly a named effect, windows may promise what they are coarser by.)
    """
    gone = found.go.intersection(e.id for e in model.effects if e.process is not None)
    about = without(model, gone) if gone else model
    known = [e for e in about.effects if e.id in found.beside.names]
    q = scan(about, [found.effect], None, worth)
    seen = beside(q, known, [found.effect])
    root = root_of([(found.effect.id, p.name) for p in found.effect.parameters], [found.effect])
    return float(gains(seen.b[None], seen.G[None], None if root is None else root[None])[0])
