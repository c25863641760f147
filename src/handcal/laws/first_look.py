"""First ranking of the drivers over which laws are searched, by constants in short time windows.

One scan of a constant in each window shows the law over any driver, as its means in the windows.
In a long recording only the first part is scanned, since a law shows in a fourth of the turning
too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from handcal.effects import Effect, Signals
from handcal.estimate.columns import Ground
from handcal.estimate.first_part import first_part
from handcal.estimate.linear import motion_of
from handcal.estimate.model import Model
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.scan import grounds
from handcal.laws.compositions import composed, composed_headings
from handcal.laws.drivers import DRIVERS, HEADING, TIME, WARM, Driver, usable
from handcal.laws.law_effect import AXES_OF, SENSORS
from handcal.laws.short_windows import (
    Courses,
    Windows,
    constants,
    courses_of,
    fits_in,
    gains_of,
    looked_at,
    means,
    windows_about,
)
from handcal.laws.vocabulary import further
from handcal.laws.weighing import Beside, beside
from handcal.types import IntArray

# At the most, of one kind of course: constants of the laws that go on to a scan, whose work grows
# with them, and laws that differ in times and widths only.
LIKELIEST, OF_A_KIND = 30, 2
# Vocabularies: the usual one of an IMU, and compositions of several signals, for an IMU and for a
# heading. Each sensor has a vocabulary of further drivers, under its name.
USUAL, COMPOSED, HEADINGS = "", "composed", "composed heading"


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """Courses of the drivers of each vocabulary in each recording's windows, filled on demand."""

    courses: dict[tuple[str, int, bytes], list[Courses]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FirstLook:
    """Recordings about a model, each on its own, whole or the first part only.

    share: of all scalar observations that are in these parts. scanned: quadratics of the windows,
    by recording and sensor, filled on demand.
    """

    parts: Sequence[tuple[Model, Ground]]
    windows: Sequence[Windows]
    share: float
    scanned: dict[tuple[int, int], Quadratic] = field(default_factory=dict)

    def likeliest(
        self, name: str, sensor: int, known: Sequence[Effect], signals: Signals, made: Vocabulary
    ) -> list[Driver]:
        """Drivers of a sensor in a vocabulary over which a law gains most beside ``known``, of each
        kind of course. Slow drivers are added if only a first part was scanned, since it may not
        show them."""
        gain: dict[str, float] = {}
        by_kind: dict[tuple[int, bool], dict[str, tuple[Driver, int]]] = {}
        for of, windows in enumerate(self.windows):
            key = name, of, windows.edges.tobytes()
            if key not in made.courses:
                made.courses[key] = self._courses(list(_drivers(name, signals)), sensor, of)
            seen = self._seen(of, sensor, known)
            for alike in made.courses[key]:
                for driver, more in zip(alike.drivers, gains_of(alike, seen), strict=True):
                    gain[driver.name] = gain.get(driver.name, 0.0) + float(more)
                    kind = by_kind.setdefault((driver.knots, driver.round), {})
                    kind[driver.name] = driver, alike.means.shape[2]
        out: list[Driver] = []
        for found in by_kind.values():
            mine = [end for end in found.values() if end[0].only in (None, sensor)]
            slow = [] if self.share == 1.0 else [d for d, _ in mine if _slow(d)]
            mine.sort(key=lambda end: -gain[end[0].name])
            out += [*slow, *_first_of((d, many) for d, many in mine if d not in slow)]
        return out

    def _courses(self, drivers: Sequence[Driver], sensor: int, of: int) -> list[Courses]:
        """Courses of the drivers in one of the recordings."""
        motion, windows = motion_of(self.parts[of][1].excited), self.windows[of]
        return courses_of(drivers, motion, sensor, len(windows.phase), windows.of)

    def _seen(self, of: int, sensor: int, known: Sequence[Effect]) -> Beside:
        """The windows of one of the recordings beside these effects, axis by axis."""
        if (of, sensor) not in self.scanned:
            self.scanned[of, sensor] = looked_at(*self.parts[of], self.windows[of], sensor)
        count = len(self.windows[of].phase)
        windows = [constants(sensor, axis, count) for axis in AXES_OF[sensor]]
        return beside(self.scanned[of, sensor], known, windows)

    def weighing(
        self, sensor: int, known: Sequence[Effect], signals: Signals, worth: float
    ) -> InWindows:
        """Evaluation of laws of a sensor beside these effects, from the windows alone.

        worth: power of the likelihood; a first part is scaled up to the whole.
        """
        of = range(len(self.parts))
        seen = [self._seen(n, sensor, known) for n in of]
        motions = [motion_of(self.parts[n][1].excited) for n in of]
        places = [(m, self.windows[n].of(m.t)) for n, m in zip(of, motions, strict=True)]
        return InWindows(signals, sensor, list(zip(seen, places, strict=True)), worth / self.share)


@dataclass(frozen=True, eq=False)
class InWindows:
    """Laws of a sensor evaluated from windows: of each recording the windows beside the known
    effects, its signals, and the window of each sample; worth: power of the likelihood."""

    signals: Signals
    sensor: int
    parts: Sequence[tuple[Beside, tuple[Signals, IntArray]]]
    worth: float

    def seen(self, absent: Sequence[Effect]) -> Beside:
        """The quadratic of effects that act on this sensor only, from the windows."""
        many = [len(e.parameters) for e in absent]
        b, G = np.zeros(sum(many)), np.zeros((sum(many), sum(many)))
        for windows, (signals, place) in self.parts:
            count = len(windows.b) // len(windows.at)
            C = np.hstack([means(e, self.sensor, signals, place, count) for e in absent])
            b += C.T @ windows.b
            G += C.T @ windows.G @ C
        ends = np.cumsum([0, *many])
        at = {e.id: np.arange(*ends[n : n + 2]) for n, e in enumerate(absent)}
        return Beside(self.worth * b, self.worth * G, at)


def first_look(model: Model, base: Sequence[Ground]) -> FirstLook:
    """The first look about a model; base: its ``grounds``."""
    part = first_part(model)
    about, here = (model, base) if part is None else (part, grounds(part))
    each = [(replace(about, parts=(f,)), own) for f, own in zip(about.parts, here, strict=True)]
    read, all_ = (sum(len(g.done.S) for g in of) for of in (here, base))
    return FirstLook(each, [windows_about(own) for own in here], read / all_)


def vocabularies(name: str, signals: Signals) -> list[str]:
    """The usual vocabulary (""), or a sensor's further one, with compositions of several signals
    if the recording is short enough."""
    if not name or not fits_in(signals):
        return [name]
    return [name, HEADINGS if name == SENSORS[HEADING] else COMPOSED]


def _drivers(name: str, signals: Signals) -> Iterable[Driver]:
    if name == USUAL:
        return (d for d in DRIVERS.values() if usable(d, signals))
    if name in SENSORS:
        return further(signals, SENSORS.index(name))
    return (composed if name == COMPOSED else composed_headings)(signals)


def _first_of(drivers: Iterable[tuple[Driver, int]]) -> list[Driver]:
    """The first of these drivers, each with its count of constants, that fit in ``LIKELIEST``."""
    out: list[Driver] = []
    kinds, room = dict[str, int](), LIKELIEST
    for driver, many in drivers:
        kinds[driver.kind] = kinds.get(driver.kind, 0) + 1
        if room > 0 and kinds[driver.kind] <= OF_A_KIND:
            out.append(driver)
            room -= many
    return out


def _slow(driver: Driver) -> bool:
    """Whether a driver varies with time or temperature."""
    return driver.free or WARM in driver.name or driver.over == TIME.name
