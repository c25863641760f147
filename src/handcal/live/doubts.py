"""What goes wrong while somebody records: the hand travels, a magnet is near, it is hot, readings
are lost. Each is told by the last seconds against the minutes before."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from handcal.types import Recording, Result

# What is looked at, s: what somebody did a moment ago and can still stop doing.
LATELY_S = 4.0
# Squared innovations beyond this many times the expected: 4 sigma of each, in the mean.
TRAVELS = 16.0
# A room bends the field by a tenth; a magnet in a phone's cover by several times the whole.
FIELD_OFF = 0.4
# Beyond this, degC, phones shut their sensors' rates down, and their biases run.
HOT_DEGC = 45.0
# Warmer by so much than at the beginning, K: a bias has moved by half a degree a second.
WARMED_K = 10.0
# Of the usual rate, and as many times the usual interval.
SLOW, GAP = 0.7, 8.0


@dataclass(frozen=True)
class Doubt:
    """What is wrong: a word for programs, and a sentence that says what to do."""

    kind: str
    sentence: str


def doubts(recording: Recording, result: Result | None) -> tuple[Doubt, ...]:
    """All that is wrong lately."""
    return (
        *_rate(recording),
        *(_travels(recording, result) if result is not None else ()),
        *_magnet(recording),
        *_heat(recording),
    )


def _rate(recording: Recording) -> Iterator[Doubt]:
    t = recording.imu.t
    steps = np.diff(t)
    if len(steps) < 20:
        return
    usual = float(np.median(steps))
    lately = steps[t[1:] > t[-1] - LATELY_S]
    if lately.max(initial=0.0) > max(GAP * usual, 0.1):
        yield Doubt("gap", f"Readings were lost for {lately.max():.1f} s: keep the page in front "
                    "and the phone near its network.")  # fmt: skip
    elif len(lately) * usual < SLOW * min(LATELY_S, float(t[-1])):
        yield Doubt("rate", f"The rate has dropped from {1 / usual:.0f} to "
                    f"{len(lately) / LATELY_S:.0f} Hz: close other pages, and leave the phone's "
                    "power saving off.")  # fmt: skip


def _travels(recording: Recording, result: Result) -> Iterator[Doubt]:
    end = float(recording.imu.t[-1])
    held = result.innovations.get("fixed_position")
    if result.assume == "rest-only" and held is None:
        yield Doubt("travels", "The hand travels, so only the rests count: turn it in one place, "
                    "as if its middle were nailed there.")  # fmt: skip
        return
    if held is None:
        return
    lately = held.nis[held.t > end - LATELY_S] / held.residual.shape[1]
    if len(lately) > 3 and float(np.mean(lately)) > TRAVELS:
        yield Doubt("travels", "The hand travels: turn it in one place, as if its middle were "
                    "nailed there.")  # fmt: skip


def _magnet(recording: Recording) -> Iterator[Doubt]:
    mag = recording.streams.get("mag")
    if mag is None or len(mag.t) < 50:
        return
    from handcal.effects.mag_hard_iron import sphere

    centre, _ = sphere(recording)
    size = np.linalg.norm(mag.value - centre, axis=1)
    usual = float(np.median(size))
    lately = size[mag.t > mag.t[-1] - LATELY_S]
    off = np.abs(lately - usual) > FIELD_OFF * usual
    if off.mean() > 0.2:
        yield Doubt("magnet", "The magnetic field is not the Earth's here: move away from iron, "
                    "loudspeakers and magnets (a cover with a clasp has one).")  # fmt: skip


def _heat(recording: Recording) -> Iterator[Doubt]:
    series = recording.streams.get("temperature")
    if series is None or not len(series.t):
        return
    value = series.value[:, 0]
    if value[-1] > HOT_DEGC:
        yield Doubt("hot", f"It is {value[-1]:.0f} degC warm inside: let it cool down.")
    elif value[-1] - value[0] > WARMED_K:
        yield Doubt("hot", f"It has warmed by {value[-1] - value[0]:.0f} K, and biases go with "
                    "it: wait until it stays as it is.")  # fmt: skip
