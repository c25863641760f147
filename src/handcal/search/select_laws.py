"""Laws without a name by the matrix of a fit: every driver as its means in short windows.

A law over a driver is a product with the matrix, so thousands of them are weighed beside any names
and noise, and in their place, without another pass of the filter. What is proposed here a fit
decides on.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from handcal.effects import Effect, Signals
from handcal.estimate.model import Model
from handcal.estimate.prior_root import root_of
from handcal.estimate.scan import scan
from handcal.estimate.transfer import without
from handcal.laws.best_law import is_composed
from handcal.laws.compositions import composed, composed_headings
from handcal.laws.drivers import DRIVERS, HEADING, Driver, usable
from handcal.laws.first_look import InWindows
from handcal.laws.law_effect import Law, effect_of
from handcal.laws.over_drivers import best_of_block, over, tuned, written_out
from handcal.laws.short_windows import Courses, courses_of, gains_of, windows_of
from handcal.laws.vocabulary import further
from handcal.laws.weighing import Beside, beside, gains
from handcal.search.response import Response, sensor_of
from handcal.search.select import Choice, Priors, chosen, windows_beside

# Drivers of a sensor that are looked at as formulas, the likeliest of all and of those that
# are no composition.
CLOSER, PLAIN = 3, 2
# Nats below the best law of a sensor within which one is its rival.
NEAR = 10.0
# Names that gain less may stand in for a law.
WEAK = 100.0


@dataclass(frozen=True, eq=False)
class Found:
    """A law as an effect; beside: the choice it is added to; nats: that it gains there; score:
    of both."""

    effect: Effect
    beside: Choice
    nats: float
    score: float


def courses_on(r: Response) -> dict[int, list[Courses]]:
    """The courses of all drivers of each sensor, once a recording."""
    signals, windows = r.motion, r.windows
    sensors = sorted(windows.sensors)
    by_name = {k: {d.name: d for d in _drivers(signals, k) if d.only in (None, k)} for k in sensors}
    # (the means of a driver are the same for both sensors of an IMU)
    imu = {name: d for k in sensors if k != HEADING for name, d in by_name[k].items()}
    here = len(windows.t), partial(windows_of, all_=signals.t, width=windows.width)
    out = {}
    if imu:
        both = courses_of(list(imu.values()), signals, 0, *here)
        out = {k: [_some(c, by_name[k]) for c in both] for k in sensors if k != HEADING}
    if HEADING in by_name:
        mine = list(by_name[HEADING].values())
        out[HEADING] = courses_of(mine, signals, HEADING, *here)
    return out


def _drivers(signals: Signals, sensor: int) -> list[Driver]:
    usual = [d for d in DRIVERS.values() if sensor != HEADING and usable(d, signals)]
    many = composed_headings(signals) if sensor == HEADING else composed(signals)
    return [*usual, *further(signals, sensor), *many]


def _some(of: Courses, names: Container[str]) -> Courses:
    """The courses of drivers of these names."""
    at = [n for n, d in enumerate(of.drivers) if d.name in names]
    return Courses([of.drivers[n] for n in at], of.means[at], of.roots)


def best_laws(
    r: Response,
    priors: Priors,
    choice: Choice,
    courses: dict[int, list[Courses]],
) -> list[list[Found]]:
    """The best laws of each sensor beside a choice, or in the place of what may stand in for them,
    the best sensor first; a fit decides between those that are near, one that is no composition
    among them."""
    signals = r.motion
    window = windows_of(signals.t, signals.t, r.windows.width)
    out = []
    for sensor, of in courses.items():
        own = []
        for other in _bases(r, priors, choice, sensor):
            b, G = windows_beside(r, other.names, other.noise, sensor)
            at = {str(a): x for a, x in enumerate(np.arange(b.size).reshape(b.shape))}
            whole = Beside(b.ravel(), G.reshape(b.size, b.size), at)
            looked = InWindows(signals, sensor, [(whole, (signals, window))], 1.0)
            for law, nats in _laws(looked, of):
                e = effect_of(law)
                if e.id not in {*priors.refused, *choice.names}:
                    own.append(Found(e, other, nats, other.score + nats + priors.of(e)))
        if own:
            out.append(_near(own))
    return sorted(out, key=lambda some: -some[0].score)


def _near(found: Sequence[Found]) -> list[Found]:
    """The best of these and the best plain one near it, each another law."""
    best = sorted(found, key=lambda f: -f.score)
    plain = [f for f in best if not is_composed(f.effect)]
    rivals = [f for f in (*best[1:2], *plain[:1]) if f.score > best[0].score - NEAR]
    return list({f.effect.id: f for f in (best[0], *rivals)}.values())


def _bases(r: Response, priors: Priors, choice: Choice, sensor: int) -> Iterator[Choice]:
    """A choice, without a sensor's noise, and without weak names as well."""
    yield choice
    rest = {i: c for i, c in choice.noise.items() if sensor_of(c.effect) != sensor}
    if len(rest) < len(choice.noise):
        yield chosen(r, priors, choice.names, rest, choice.steps)
    score = choice.where.score
    weak = {
        i
        for i in choice.names - priors.always
        if score(choice.names) - score(choice.names - {i}) < WEAK
    }
    if weak:
        yield chosen(r, priors, choice.names - weak, rest, choice.steps)


def _laws(looked: InWindows, courses: Sequence[Courses]) -> Iterator[tuple[Law, float]]:
    """The likeliest laws as formulas and curves, with what they gain, their costs unpaid."""
    ((whole, _),) = looked.parts
    ranked = sorted(
        (
            (float(nats), driver)
            for of in courses
            for nats, driver in zip(gains_of(of, whole), of.drivers, strict=True)
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
                if law.form.smooth:
                    yield from ((x, v + x.form.cost) for x, v in written_out(looked, law, looked))


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
    gone = {e.id for e in model.effects if e.process is not None} - found.beside.noise.keys()
    about = without(model, gone) if gone else model
    known = [e for e in about.effects if e.id in found.beside.names]
    q = scan(about, [found.effect], None, worth)
    seen = beside(q, known, [found.effect])
    root = root_of([(found.effect.id, p.name) for p in found.effect.parameters], [found.effect])
    return float(gains(seen.b[None], seen.G[None], None if root is None else root[None])[0])
