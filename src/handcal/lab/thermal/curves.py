"""Bias and scale against temperature (paper 004), from rests while the temperature changes.

Soak or ramp alike: a rest is cut into pieces in which the temperature hardly changes. A
parameter of the catalogue's effects becomes a curve, a sum of functions of temperature, and the
evidence says which functions: a polynomial or a spline, and how many. In a rest the rate is zero
and gravity keeps its direction, whichever that is; a reference (``/reference``) says both, and
the rate of turns, so that the gyro's scale becomes a curve too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.lab.sound import doubts, refuse_incredible
from handcal.lab.thermal.basis import Basis, candidates
from handcal.lab.thermal.fit import best_extra
from handcal.lab.thermal.model import (
    SENSORS,
    Done,
    Model,
    directions,
    models,
    scene,
    solved,
    with_bases,
)
from handcal.lab.thermal.pieces import FINE, Pieces, joined, pieces_of
from handcal.types import Array, HandcalError, Recording

LEAST_SPAN = 3.0
FEWEST_PIECES = 4
TELLING = 0.5
# A temperature that changes faster than this counts as rising or falling, K/s.
DRIFT = 0.003
# Standard errors by which readings differ that do not only depend on the temperature.
APART = 5.0
Progress = Callable[[float], None]
Notes = dict[str, tuple[float, tuple[str, float]]]


@dataclass(frozen=True)
class Curve:
    """One parameter against temperature: coefficients c (k,) of a basis, their covariance (k, k).

    anchored: its value is known; else only how it changes, and ``at`` gives the change against
    the middle of the span. gain: nats of evidence over a constant; runner: what came second, and
    by how many nats.
    """

    effect: str
    name: str
    unit: str
    basis: Basis
    c: Array
    P: Array
    anchored: bool
    gain: float
    runner: tuple[str, float]

    def at(self, T: Array) -> tuple[Array, Array]:
        """Values and standard deviations (n,) at temperatures T (n,)."""
        B = self.basis.values(T)
        if not self.anchored:
            B = B - self.basis.values(np.array([self.basis.middle]))
        return B @ self.c, np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", B, self.P, B), 0.0))


@dataclass(frozen=True)
class Thermal:
    """What the recordings say. pieces; curves; residual (n, 6): what is left, and before (n, 6):
    without any change by temperature; extra: noise beyond that within pieces, by sensor."""

    recordings: tuple[Recording, ...]
    pieces: Pieces
    curves: tuple[Curve, ...]
    before: Array
    residual: Array
    extra: dict[str, float]
    warnings: tuple[str, ...]

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest temperature, degC."""
        return float(self.pieces.T.min()), float(self.pieces.T.max())


def thermal(
    recordings: Sequence[Recording],
    gravity: float = STANDARD_GRAVITY,
    progress: Progress | None = None,
) -> Thermal:
    """Curves of one device from its recordings.

    Errors: InputError where a recording has no temperature; HandcalError where it hardly
    changes, or the device hardly rests.
    """
    report = progress or (lambda _: None)
    pieces = joined([pieces_of(r, i) for i, r in enumerate(recordings)])
    low, high = float(pieces.T.min()), float(pieces.T.max())
    if high - low < LEAST_SPAN:
        raise HandcalError(
            f"The temperature changes by {high - low:.1f} K only, from {low:.1f} to {high:.1f} "
            "degC, while the device rests: warm or cool it by ten degrees or more."
        )
    if len(pieces) < FEWEST_PIECES:
        raise HandcalError(
            f"{len(pieces)} rests are too few for a curve: let the device rest at several "
            "temperatures, or all the time while it warms up."
        )
    levels = len(np.unique(np.round((pieces.T - low) / (FINE * (high - low)))))
    options = candidates(low, high, levels)
    curves: list[Curve] = []
    before, residual = np.zeros((len(pieces), 6)), np.zeros((len(pieces), 6))
    extra, said = {}, []
    for s, sensor in enumerate(SENSORS):
        start = models(sensor, pieces, options[0])
        model, warning = _told(start, s, pieces, gravity, options)
        said += warning
        chosen, notes = _search(model, s, pieces, gravity, options)
        report(0.5 * (s + 1))
        done = solved(chosen, s, pieces, gravity)
        own = slice(3 * s, 3 * s + 3)
        residual[:, own], extra[sensor] = done.left, done.extra
        before[:, own] = solved(model, s, pieces, gravity).left
        curves += _curves(chosen, done, notes)
    middle = np.array([0.5 * (low + high)])
    known = [c for c in curves if c.anchored]
    refuse_incredible((c.effect, c.name, float(c.at(middle)[0][0])) for c in known)
    warnings = (*doubts(extra), *said, *_lag(pieces, residual))
    return Thermal(tuple(recordings), pieces, tuple(curves), before, residual, extra, warnings)


def _told(
    model: Model, s: int, pieces: Pieces, gravity: float, options: Sequence[Basis]
) -> tuple[Model, list[str]]:
    """The model with a scale that does not change where the attitudes do not tell it, even if
    the bias bends."""
    if len(model.changing) == 1:
        return model, []
    bent = with_bases(model, (options[min(2, len(options) - 1)], options[0]))
    sigma = solved(bent, s, pieces, gravity).sigma
    fixed = sum(len(e.parameters) for e in model.constant)
    told = np.r_[sigma[:fixed], sigma[-3:]] < TELLING * np.r_[bent.usual[:fixed], bent.usual[-3:]]
    if told.all():
        return model, []
    name = ("gyro", "accelerometer")[s]
    more = "turns about all axes at known rates" if s == 0 else "rests on all sides"
    said = (
        f"The {name}'s scale was not told apart from its bias: that takes {more}, at each "
        "temperature. It is taken as constant, so that what it changes is in the bias."
    )
    (bias, (scale, _)) = model.changing[:1], model.changing[1]
    return Model((scale, *model.constant), bias), [said]


def _search(
    model: Model, s: int, pieces: Pieces, gravity: float, options: Sequence[Basis]
) -> tuple[Model, Notes]:
    """The bases with most evidence, one effect after the other until none changes; of each its
    gain over a constant and what came second."""
    known: dict[tuple[Basis, ...], float] = {}
    d = directions(pieces)

    def worth(bases: Sequence[Basis]) -> float:
        key = tuple(bases)
        if key not in known:
            trial = with_bases(model, key)
            rows = scene(trial, s, pieces, gravity, d).rows(np.zeros_like(trial.usual))
            known[key] = best_extra(rows)[1]
        return known[key]

    chosen = [b for _, b in model.changing]

    def scores_of(i: int) -> dict[Basis, float]:
        return {b: worth([*chosen[:i], b, *chosen[i + 1 :]]) for b in options}

    before: list[Basis] = []
    while chosen != before:
        before = list(chosen)
        for i in range(len(chosen)):
            scores = scores_of(i)
            chosen[i] = max(options, key=scores.__getitem__)
    notes = {}
    for i, (effect, _) in enumerate(model.changing):
        scores = scores_of(i)
        best = scores.pop(chosen[i])
        second = max(scores, key=scores.__getitem__)
        flat = best if chosen[i] == options[0] else scores[options[0]]
        notes[effect.id] = (best - flat, (second.title, best - scores[second]))
    return with_bases(model, chosen), notes


def _curves(model: Model, done: Done, notes: Notes) -> list[Curve]:
    out = []
    at = sum(len(e.parameters) for e in model.constant)
    for effect, basis in model.changing:
        m = len(effect.parameters)
        gain, runner = notes[effect.id]
        for i, p in enumerate(effect.parameters):
            index = [at + i + m * k for k in range(basis.size)]
            P = done.P[np.ix_(index, index)]
            anchored = bool(np.sqrt(P[0, 0]) < TELLING * p.prior_sigma)
            out.append(
                Curve(effect.id, p.name, p.unit, basis, done.x[index], P, anchored, gain, runner)
            )
        at += m * basis.size
    return out


def _lag(pieces: Pieces, residual: Array) -> list[str]:
    """A warning where readings at the same temperature depend on whether it rises or falls."""
    rising, falling = pieces.slope > DRIFT, pieces.slope < -DRIFT
    if min(rising.sum(), falling.sum()) < FEWEST_PIECES:
        return []
    up, down = residual[rising], residual[falling]
    apart = up.mean(axis=0) - down.mean(axis=0)
    error = np.sqrt(up.var(axis=0, ddof=1) / len(up) + down.var(axis=0, ddof=1) / len(down))
    if float((np.abs(apart) / np.maximum(error, 1e-300)).max()) < APART:
        return []
    return [
        "At the same temperature the readings depend on whether it rises or falls: the sensors are "
        "not as warm as the thermometer says. Change the temperature more slowly, or let it settle."
    ]
