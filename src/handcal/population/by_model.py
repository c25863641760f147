"""All that the recordings of a fleet tell of the devices of each model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from handcal.device.file import Name, kept, persistent, unit_of, usual_of
from handcal.effects import catalogue
from handcal.population import joint, odd
from handcal.population.deconvolved import LEAST, Population, population
from handcal.population.drift import Drift, drift
from handcal.population.grouped import devices, owners, telling
from handcal.population.joint import Information
from handcal.population.laws import Asked, CommonLaw, better, common_law
from handcal.population.odd import Odd
from handcal.population.stacked import FOUND, Stack, stack
from handcal.types import Array, IntArray

# Effects that are looked for one after the other in a model of device.
MOST = 4
# A spread is told where the ends of its interval are no further apart than this factor; else the
# catalogue's usual size stays in place.
TOLD = 4.0


@dataclass(frozen=True)
class Reading:
    """What one recording tells: its label, model and device ("" if not known); value and sigma
    of each parameter, SI, and which of them were estimated together; gravity m/s^2; what it tells
    of all parameters at once, where that is known; started: s since 1970, temperature: degC, nan
    if not known; laws: value and sigma (k,) of the constants of those without a name, if it
    was asked about these."""

    label: str
    model: str
    device: str
    values: Mapping[Name, tuple[float, float]]
    together: frozenset[Name]
    gravity: float
    information: Information | None = None
    started: float = math.nan
    temperature: float = math.nan
    laws: tuple[Array, Array] | None = None


@dataclass(frozen=True)
class Change:
    """How one parameter changes between the recordings of a device: begun at started (n,), value
    (n,) (SI), of the devices who (n,), in the order in which they were given."""

    effect: str
    name: str
    unit: str
    drift: Drift
    started: Array
    value: Array
    who: tuple[str, ...]


@dataclass(frozen=True)
class Common:
    """One parameter over the devices of a model: its population, the devices' names, values (d,)
    and sigmas (d,), SI; usual: the catalogue's; stays: a device keeps it from one recording to the
    next."""

    effect: str
    name: str
    unit: str
    usual: float
    stays: bool
    population: Population
    who: tuple[str, ...]
    value: Array
    sigma: Array

    @property
    def own(self) -> bool:
        """Whether it is of the device, as its file would keep it: of no room, no hand and no stream
        beside the IMU's own."""
        return kept((self.effect, self.name)) and not _of_the_world(self.effect)

    @property
    def told(self) -> bool:
        """Whether the recordings tell the spread, or at least that a new device is better known by
        them than by the usual size."""
        p = self.population
        new = math.hypot(p.deviation, 0.25 * (p.high - p.low), p.mean_sigma)
        return new < self.usual or p.high < TOLD * p.low


@dataclass(frozen=True)
class Model:
    """name; how many recordings and devices; its populations, stacked effects (most probable
    first) and odd ones (oddest first); how parameters change from one recording to the next; the
    law without a name that the devices have in common."""

    name: str
    recordings: int
    devices: int
    common: tuple[Common, ...]
    stacks: tuple[Stack, ...]
    odd: tuple[Odd, ...]
    changes: tuple[Change, ...] = ()
    law: CommonLaw | None = None


def stays(effect: str) -> bool:
    """Whether a device keeps an effect's parameters from one recording to the next."""
    return persistent(catalogue()[effect]) and not _of_the_world(effect)


def _of_the_world(effect: str) -> bool:
    # (a device file keeps the arm of a board that is mounted; in a hand it is another every time)
    return catalogue()[effect].world


def models(
    readings: Sequence[Reading], laws: Asked | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> tuple[Model, ...]:  # fmt: skip
    """Of each model what its recordings tell, in the order of their names; laws: those that the
    readings were asked about; report: called with the name of each before it is looked at."""
    by_model: dict[str, list[Reading]] = {}
    for r in readings:
        by_model.setdefault(r.model, []).append(r)
    tables = {m: _table(rs) for m, rs in by_model.items()}
    trials = sum(len({n[0] for n in t if stays(n[0])}) for t in tables.values())
    found = []
    for m in sorted(by_model):
        report(m)
        found.append(_model(m, by_model[m], tables[m], max(1, trials)))
    if laws is None:
        return tuple(found)
    many = len(laws.usual) * len(found)
    return tuple(replace(m, law=_law(by_model[m.name], m.stacks, laws, many)) for m in found)


def _table(readings: Sequence[Reading]) -> dict[Name, tuple[Array, Array]]:
    """Values (n,) and sigmas (n,) of each parameter, nan where a recording does not tell it."""
    names = dict.fromkeys(n for r in readings for n in r.values if n[0] in catalogue())
    nothing = (float("nan"), float("nan"))
    out = {}
    for name in names:
        rows = np.array([r.values.get(name, nothing) for r in readings])
        out[name] = (rows[:, 0], rows[:, 1])
    return out


def _model(
    name: str, every: Sequence[Reading], whole: Mapping[Name, tuple[Array, Array]], trials: int
) -> Model:
    names = [r.device or r.label for r in every]
    labels = [r.label for r in every]
    at_all = {n for r in every for n in r.together}
    strange = odd.recordings(labels, names, {n: whole[n] for n in whole
                                             if n in at_all and stays(n[0])})  # fmt: skip
    # (a recording of another device would be taken for a scatter of its own)
    elsewhere = {o.who for o in strange if o.left_out}
    readings = [r for r in every if r.label not in elsewhere]
    table = whole if not elsewhere else _table(readings)
    who = owners([r.device for r in readings])
    names = [r.device or r.label for r in readings]
    together = {n for r in readings for n in r.together}
    stacks, sharper, each = _stacked(readings, table, who, together, trials)
    found = {s.effect for s in stacks if s.probability > FOUND}
    devices = tuple(dict.fromkeys(names))
    values = {
        n: (sharper[n], devices) if n in sharper else (table[n], names)
        for n in table
        if n in together or n[0] in found
    }
    there, unlike = _populations(values, devices)
    lasting = {n: each.get(n, table[n]) for n in table if n in together and stays(n[0])}
    strange = [*(o for o in strange if o.left_out),
               *odd.recordings([r.label for r in readings], names, lasting)]  # fmt: skip
    ordered = (
        *odd.unlike_gravity(labels, [r.gravity for r in every]),
        *sorted((*unlike, *strange), key=lambda o: o.by_chance),
    )
    changes = _changes(readings, {n: each.get(n, table[n]) for n in table if n in together}, names)
    return Model(name, len(every), len(devices), there, stacks, ordered, changes)


def _populations(
    values: Mapping[Name, tuple[tuple[Array, Array], Sequence[str]]], devices: Sequence[str]
) -> tuple[tuple[Common, ...], list[Odd]]:
    """Each parameter over the devices, and the odd ones of these, without which that is told."""
    common = [_common(n, *values[n]) for n in values]
    told = {
        (c.effect, c.name): (c.population, *_aligned(c, devices))
        for c in common
        if c is not None and not _of_the_world(c.effect)
    }
    unlike = odd.devices(devices, told)
    out = frozenset(o.who for o in unlike if o.left_out)
    if out:
        common = [_common(n, *values[n], out) for n in values]
    return tuple(c for c in common if c is not None), unlike


def _stacked(
    readings: Sequence[Reading], table: Mapping[Name, tuple[Array, Array]], who: IntArray,
    together: Set[Name], trials: int,
) -> tuple[tuple[Stack, ...], Mapping[Name, tuple[Array, Array]],
           Mapping[Name, tuple[Array, Array]]]:  # fmt: skip
    """As ``_at_once``, or of each parameter by itself where recordings do not tell all at once."""
    if who.max() + 1 < LEAST:
        return (), {}, {}  # (what two devices have in common is no population)
    at_once = [r.information for r in readings if r.information is not None]
    if len(at_once) == len(readings):
        return _at_once(at_once, who, together, trials)
    return _stacks(table, who, trials), {}, {}


def _law(
    readings: Sequence[Reading], stacks: Sequence[Stack], laws: Asked, trials: int
) -> CommonLaw | None:
    """What no effect of the catalogue explains as well."""
    asked = [(r.device or r.label, r.laws) for r in readings if r.laws is not None]
    if not asked:
        return None
    value, sigma = (np.stack([told[k] for _, told in asked]) for k in range(2))
    found = common_law(laws, value, sigma, [name for name, _ in asked], trials)
    # (what is in every fit has been taken out of what is told of laws)
    always = {n[0] for r in readings for n in r.together}
    others = [s for s in stacks if s.effect not in always]
    return found if found is not None and better(found, others) else None


def _changes(
    readings: Sequence[Reading], table: Mapping[Name, tuple[Array, Array]], names: Sequence[str]
) -> tuple[Change, ...]:
    """Of every parameter but those of the hand and the place."""
    started, warm = (
        np.array([getattr(r, k) for r in readings]) for k in ("started", "temperature")
    )
    looked_at = [n for n in table if not _of_the_world(n[0])]
    out = []
    for n in looked_at:
        value, sigma = table[n]
        usual = float(usual_of([n])[0])
        found = drift(value, sigma, owners(names), started, warm, usual, names, len(looked_at))
        if found is not None:
            out.append(Change(*n, unit_of(n), found, started, value, tuple(names)))
    return tuple(out)


def _common(
    name: Name, values: tuple[Array, Array], names: Sequence[str], out: Set[str] = frozenset()
) -> Common | None:
    """None where too few devices tell of it; the population is that of all devices but some."""
    at = np.flatnonzero(np.isfinite(values[0]) & np.isfinite(values[1])).tolist()
    kept = [i for i in at if names[i] not in out]
    here = owners([names[i] for i in kept])
    if not kept or here.max() + 1 < LEAST:
        return None
    lasting = stays(name[0])
    value, sigma = values
    p = population(value[kept], sigma[kept], here, lasting)
    apart = 0.0 if lasting or np.isnan(p.apart) else p.apart
    d = devices(value[at], sigma[at], owners([names[i] for i in at]), apart)
    whose = tuple(dict.fromkeys(names[i] for i in at))
    return Common(*name, unit_of(name), float(usual_of([name])[0]), lasting, p, whose,
                  d.value, d.sigma)  # fmt: skip


def _aligned(c: Common, every: Sequence[str]) -> tuple[Array, Array]:
    """Values and sigmas of a parameter for every device of the model, nan where it has none."""
    at = {n: i for i, n in enumerate(c.who)}
    index = [at.get(n, -1) for n in every]
    x, s = np.r_[c.value, np.nan], np.r_[c.sigma, np.nan]
    return x[index], s[index]


def _stacks(
    table: Mapping[Name, tuple[Array, Array]], who: IntArray, trials: int
) -> tuple[Stack, ...]:
    by_effect: dict[str, list[Name]] = {}
    for n in table:
        if stays(n[0]):
            by_effect.setdefault(n[0], []).append(n)
    out = []
    for effect, names in by_effect.items():
        values = []
        for n in names:
            d = devices(*telling(*table[n], who))
            values.append((d.value, d.sigma))
        out.append(stack(effect, values, usual_of(names), trials))
    return tuple(sorted(out, key=lambda s: (-s.probability, -s.gain)))


def _at_once(
    readings: Sequence[Information], who: IntArray, together: Set[Name], trials: int
) -> tuple[tuple[Stack, ...], dict[Name, tuple[Array, Array]], dict[Name, tuple[Array, Array]]]:
    """Stacked effects, one found after the other, each beside those before it; and where any was
    found that is not in every fit, values and sigmas of devices (d,) and of recordings (n,) with it
    in the model."""
    listed = tuple(dict.fromkeys(n for r in readings for n in r.names if n[0] in catalogue()))
    always = [n for n in listed if n in together and stays(n[0])]
    passing = [n for n in listed if n in together and not stays(n[0])]
    left = dict.fromkeys(n[0] for n in listed if stays(n[0]))
    found: dict[str, Stack] = {}
    while True:
        stacks = {}
        base = joint.without(joint.of_devices(readings, who, always, passing), always)
        for effect in left:
            own = [n for n in listed if n[0] == effect and n not in always]
            told = joint.of_devices(readings, who, [*always, *own], passing)
            stacks[effect] = joint.stack(told, always, effect, trials, base if own else None)
        new = [s for s in stacks.values() if not {n for n in always if n[0] == s.effect}]
        best = max(new, key=lambda s: s.probability, default=None)
        if best is None or best.probability <= FOUND or len(found) == MOST:
            break
        found[best.effect] = best
        del left[best.effect]
        always += [n for n in listed if n[0] == best.effect]
    every = sorted((*found.values(), *stacks.values()), key=lambda s: (-s.probability, -s.gain))
    if not found:
        return tuple(every), {}, {}
    told = joint.of_devices(readings, who, always, passing)
    alone = joint.of_devices(readings, np.arange(len(readings)), always, passing)
    population_of = joint.fit(told)
    of_devices, of_recordings = (_sharper(t, set(found), *population_of) for t in (told, alone))
    return tuple(every), of_devices, of_recordings


def _sharper(
    told: joint.Told, found: Set[str], mean: Array, spread: Array
) -> dict[Name, tuple[Array, Array]]:
    """Each parameter as devices or recordings tell it, SI (nan where they do not), with what was
    found in the model: that is drawn from its population, of this mean (k,) and spread (k,) in
    usual sizes, and the rest has its usual size."""
    own = np.array([n[0] in found for n in told.names])
    mean, spread = np.where(own, mean, 0.0), np.where(own, spread, 1.0)
    usual = usual_of(told.names)
    out = {}
    for name, size in zip(told.names, usual, strict=True):
        value, sigma = joint.marginals(told, mean, spread, name)
        there = np.isfinite(value) & np.isfinite(sigma)
        out[name] = (np.where(there, value * size, np.nan), np.where(there, sigma * size, np.nan))
    return out
