"""The best law or course without a name beside a model, from scans of all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

import numpy as np

from handcal.effects import Effect, Signals
from handcal.estimate.columns import Ground, columns_of, in_groups
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Fitted, Model
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.scan import grounds, scan
from handcal.laws import shapes, terms
from handcal.laws.course_numbers import ROUGHLY, nearer
from handcal.laws.courses import COURSES
from handcal.laws.drivers import HEADING, Driver
from handcal.laws.first_look import USUAL, FirstLook, Vocabulary, first_look, vocabularies
from handcal.laws.grammar import formula
from handcal.laws.law_effect import SENSORS, Law, channel_of, effect_of, law_of
from handcal.laws.over_drivers import (
    About,
    Block,
    Weighing,
    best_of_block,
    over,
    signals_of,
    tuned,
    written_out,
)
from handcal.laws.vocabulary import CURVED
from handcal.laws.weighing import beside, gains, weighed, wide_root
from handcal.model_score import TERM_PRIOR
from handcal.types import IntArray

# Largest and smallest count of columns in one scan, and count of numbers that they may take
# (150 MB), with some thirty numbers per epoch and column.
MOST_COLUMNS, LEAST_COLUMNS = 140, 30
NUMBERS, PER_EPOCH = 2e7, 30.0
# The best drivers, of which formulas are tried.
CLOSER = 3
# Gain of a law in a scan from which it is considered, nats.
ENOUGH = math.log(2.0) - TERM_PRIOR
# Accuracy of a gain in a scan, nats: closer laws are not told apart.
UNTOLD = 3.0

# Arguments of ``best_terms`` by which results are kept: beyond, without.
Asked = tuple[tuple[str, ...], frozenset[str]]


@dataclass(frozen=True, eq=False)
class Term:
    """A law or course without a name, and its gain at the full likelihood, nats; others:
    alternatives to it that gain less in a scan, other forms or drivers."""

    effect: Effect
    gain: float
    others: tuple[Effect, ...] = ()


@dataclass(frozen=True, eq=False)
class Survey:
    """All scans of laws about a model, filled on demand.

    base: the model's ``grounds``. signals: of its first recording. scanned: scans and their
    quadratics, under "" (the usual vocabulary) and each sensor. first: ranking of the drivers.
    worth: power of the likelihood (None: the median of the scans). found: results of ``best_terms``
    by its arguments.
    """

    model: Model
    base: Sequence[Ground]
    signals: Signals
    vocabulary: Vocabulary
    scanned: dict[str, list[tuple[Look, Quadratic]]]
    first: FirstLook
    worth: float | None = None
    found: dict[Asked, tuple[About, list[Term]]] = field(default_factory=dict)

    def of(self, beyond: Collection[str], known: Sequence[Effect]) -> list[tuple[Look, Quadratic]]:
        """Scans and their quadratics, of the usual vocabulary and the further ones of the sensors
        in ``beyond``; known: effects beside which laws are evaluated."""
        for name in (USUAL, *beyond):
            self._scan(name, known)
        return [pair for name in (USUAL, *beyond) for pair in self.scanned[name]]

    def _scan(self, name: str, known: Sequence[Effect]) -> None:
        """Scan the laws of a vocabulary that have not been scanned yet."""
        f = self.model.parts[0]
        looks = [] if name in self.scanned else list(_others(f, name))
        done = self.scanned.setdefault(name, [])
        have = {e.id for look, _ in done for e in look.effects}
        new = [b for b in self._blocks(name, known) if b.effect.id not in have]
        room = min(max(NUMBERS / (PER_EPOCH * len(f.t)), LEAST_COLUMNS), MOST_COLUMNS)
        looks += [
            Look([b.effect for b in chunk], partial(_laws, chunk))
            for chunk in in_groups(new, _columns, int(room))
        ]
        done += _scans(self.model, looks, self.base, self.worth)

    def _blocks(self, name: str, known: Sequence[Effect]) -> Iterator[Block]:
        """Laws over the drivers that rank highest."""
        for words in vocabularies(name, self.signals):
            for sensor in [SENSORS.index(name)] if name else range(HEADING):
                asked = sensor, known, self.signals, self.vocabulary
                for driver in self.first.likeliest(words, *asked):
                    yield from over(driver, self.signals, (sensor,))


def survey(
    model: Model, vocabulary: Vocabulary | None = None, worth: float | None = None
) -> Survey:
    """An empty survey of a model.

    vocabulary: courses of the same recordings that other surveys computed; it is added to. worth:
    power of the likelihood, if known.
    """
    made, base = Vocabulary() if vocabulary is None else vocabulary, grounds(model)
    return Survey(model, base, signals_of(model.parts[0]), made, {}, first_look(model, base), worth)


def _scans(
    model: Model, looks: Sequence[Look], base: Sequence[Ground], worth: float | None
) -> Iterator[tuple[Look, Quadratic]]:
    scans = in_parallel(partial(scan, model, look.effects, base, worth) for look in looks)
    return zip(looks, scans, strict=True)


def best_term(where: Survey, *, refused: Collection[str] = ()) -> Term | None:
    """The term with the highest gain over the model; None if none gains enough."""
    found = best_terms(where, refused=refused)
    return max(found, key=lambda t: t.gain, default=None)


def best_terms(
    where: Survey,
    *,
    refused: Collection[str] = (),
    without: Collection[str] = (),
    beyond: Collection[str] = (),
) -> list[Term]:
    """The terms (laws over drivers, courses over time or direction) with the highest gain over the
    model, overall and for each sensor in ``beyond``, among those that gain enough.

    refused: formulas to leave out. without: effects of the model, none of them noise, to be
    replaced by a term. beyond: "gyro", "accel" or "heading", whose whole vocabulary is scanned.
    """
    asked = tuple(beyond), frozenset(without)
    # (kept, since a search asks again with more formulas refused)
    if asked not in where.found:
        where.found[asked] = _found(where, *asked)
    about_, found = where.found[asked]
    found = [t for t in found if t.effect.id not in refused]
    own = [[t for t in found if t.effect.id.startswith(sensor)] for sensor in beyond]
    best = dict.fromkeys([*found[:1], *(t for some in own for t in _first_ones(some))])
    # (a scan finds courses on a grid of seconds, which may cost hundreds of nats)
    near = [_nearer(about_, _with_rivals(t, found)) for t in best]
    return [t for t in near if t.effect.id not in refused]


def _found(
    where: Survey, beyond: Collection[str], without: Collection[str]
) -> tuple[About, list[Term]]:
    """All terms that ``best_terms`` may choose from, best first, and where they were evaluated."""
    known = [e for e in where.model.effects if e.process is None and e.id not in without]
    pairs = where.of(beyond, known)
    # (the measured worth differs from scan to scan: one for all keeps gains comparable)
    worth = float(np.median([q.worth for _, q in pairs]))
    ends = [
        end for look, q in pairs for end in look.best(weighed(q, worth), known) if end[1] > ENOUGH
    ]
    about_ = About(where.model, where.base, known, where.signals, worth)
    quick = partial(where.first.weighing, known=known, signals=where.signals, worth=worth)
    found = _nameless(about_, [(e, gain) for e, gain in ends if isinstance(e, Effect)], quick)
    told = in_parallel(partial(_as_told, about_, *end, quick) for end in _closer(ends, beyond))
    found += [_first_of(about_, [(effect_of(law), nats) for law, nats in some]) for some in told]
    return about_, sorted(found, key=lambda t: -t.gain)


def _nameless(
    about_: About, ends: Sequence[tuple[Effect, float]], quick: Callable[[int], Weighing]
) -> list[Term]:
    """Courses, and terms and curves of the heading, with their gains.

    The best curve is joined by its formulas, the best course by courses of other families on its
    channel: on a scan's grid of seconds a sawtooth is nearly a sine.
    """
    ends = sorted(ends, key=lambda end: -end[1])
    several = []
    driven = ((end, driver) for end in ends if (driver := _driver_of(end[0])) is not None)
    for curve, driver in islice(driven, 1):
        law = Law(HEADING, (0,), False, driver, formula([("line", ())]), (1.0,))
        formulas = written_out(about_, law, quick(HEADING))
        several.append([curve, *((effect_of(x), gain) for x, gain in formulas)])
    courses = [end for end in ends if end[0].made is not None and end[0].made[0] in COURSES]
    if courses:
        several.append(
            [end for end in courses if channel_of(end[0].id) == channel_of(courses[0][0].id)]
        )
    out = [[end] for end in ends if not any(end in some for some in several)]
    return [_first_of(about_, some) for some in (*out, *several)]


def _first_ones(found: Sequence[Term]) -> list[Term]:
    """The best term, and the best that is no composition: among thousands of compositions the
    highest gain may be chance."""
    plain = [t for t in found if not is_composed(t.effect)]
    return list(dict.fromkeys([*found[:1], *plain[:1]]))


def is_composed(effect: Effect) -> bool:
    """Whether this is a law over a composition of several signals and an operator."""
    law = law_of(effect)
    return law is not None and law.driver.composed


def _nearer(about_: About, term: Term) -> Term:
    effect, nats = nearer(about_, term.effect, ROUGHLY)
    return replace(term, effect=effect, gain=term.gain + nats / about_.worth)


def _with_rivals(term: Term, found: Sequence[Term]) -> Term:
    """A term with its alternatives on the same channel whose gains are within ``UNTOLD``."""
    near = [
        t for t in found if t is not term and channel_of(t.effect.id) == channel_of(term.effect.id)
    ]
    rivals = [t.effect for t in near if t.gain > term.gain - UNTOLD]
    return replace(term, others=(*term.others, *rivals))


def _first_of(about_: About, ends: Sequence[tuple[Effect, float]]) -> Term:
    ends = sorted(ends, key=lambda end: -end[1])
    first, *others = (e for e, _ in ends)
    return Term(first, ends[0][1] / about_.worth, tuple(others))


def _driver_of(effect: Effect) -> Driver | None:
    """The driver of a curve of the heading that a formula may replace; None for other effects."""
    kind = "" if effect.made is None else effect.made[0]
    return CURVED.get(kind.removeprefix(terms.CURVE)) if kind.startswith(terms.CURVE) else None


def _as_told(
    about_: About, law: Law, gain: float, quick: Callable[[int], Weighing]
) -> list[tuple[Law, float]]:
    """The law, with its driver's number tuned, and its formulas if it is a curve, with gains."""
    if law.driver.number:
        law, gain = tuned(about_, law, gain)
        gain -= law.cost
    ends = written_out(about_, law, quick(law.sensor)) if law.form.smooth else []
    return [*ends, (law, gain)]


End = tuple[Law | Effect, float]


@dataclass(frozen=True)
class Look:
    """The effects of one scan, and a function that finds the best of them in its quadratic, beside
    the known effects."""

    effects: Sequence[Effect]
    best: Callable[[Quadratic, Sequence[Effect]], list[End]]


def _others(f: Fitted, beyond: str) -> Iterator[Look]:
    """Scans other than of laws over drivers: courses over time, and errors of a heading. They
    belong to the usual vocabulary only."""
    recording = f.case.recording
    if beyond:
        return
    for first in range(0, 6, 2):
        spans = [shapes.imu_basis(first + n, recording.duration_s) for n in range(2)]
        yield Look([b.effect for b in spans], partial(_courses, spans))
    if "heading" in f.case.kinds:
        options = [[e] for e in terms.heading_terms(recording)] + terms.heading_curves()
        # (under ids of their own, since the model may have some of them)
        looked = [replace(some[0], id=f"basis: {n}") for n, some in enumerate(options)]
        yield Look(looked, partial(_headings, looked, options))
        bases = shapes.heading_bases(recording.duration_s)
        yield Look([b.effect for b in bases], partial(_courses, bases))


def _columns(block: Block) -> int:
    return columns_of(block.effect)


def _laws(chunk: Sequence[Block], q: Quadratic, known: Sequence[Effect]) -> list[End]:
    seen = beside(q, known, [b.effect for b in chunk])
    return [end for b in chunk for end in best_of_block(b, seen)]


def _closer(ends: Sequence[End], beyond: Collection[str]) -> list[tuple[Law, float]]:
    """The best laws over different drivers, overall and for each sensor in ``beyond``.

    They include the best curve, since its formula gains more (a curve pays for its freedom), and
    the best law that is no composition.
    """
    best: dict[tuple[int, str], tuple[Law, float]] = {}
    for law, gain in sorted(ends, key=lambda e: -e[1]):
        if isinstance(law, Law):
            best.setdefault((law.sensor, law.driver.kind), (law, gain))
    laws = list(best.values())
    out = _best_of(laws)
    for sensor in beyond:
        own = [end for end in laws if SENSORS[end[0].sensor] == sensor]
        out += [end for end in _best_of(own) if end not in out]
    return out


def _best_of(laws: Sequence[tuple[Law, float]]) -> list[tuple[Law, float]]:
    curve = [end for end in laws if end[0].form.smooth]
    plain = [end for end in laws if not end[0].driver.composed]
    first = list(laws[:CLOSER])
    return first + [end for some in (curve, plain) for end in some[:1] if end not in first]


def _courses(bases: Sequence[shapes.Basis], q: Quadratic, known: Sequence[Effect]) -> list[End]:
    ids = {e.id for e in known}
    index: IntArray = np.array([i for i, n in enumerate(q.names) if n[0] in ids], dtype=np.int64)
    return [end for b in bases for end in shapes.closest(b, q, index, wide_root(q, known, index))]


def _headings(
    looked: Sequence[Effect],
    options: Sequence[Sequence[Effect]],
    q: Quadratic,
    known: Sequence[Effect],
) -> list[End]:
    """Terms and curves of the heading that the model lacks, with their gains."""
    seen = beside(q, known, looked)
    here = {e.id for e in known}
    out: list[End] = []
    for e, some in zip(looked, options, strict=True):
        if some[0].id in here:
            continue
        at = seen.at[e.id]
        b, G = seen.b[at], seen.G[np.ix_(at, at)]
        roots = np.stack([np.eye(len(at)) if x.together is None else x.together for x in some])
        many = len(roots), len(at), len(at)
        found = gains(np.broadcast_to(b, many[:2]), np.broadcast_to(G, many), roots)
        gain = float(found.max() + math.log(np.mean(np.exp(found - found.max()))))
        out.append((some[int(np.argmax(found))], gain))
    return out
