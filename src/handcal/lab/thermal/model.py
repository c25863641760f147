"""A sensor's readings as curves of temperature: what they change with, and the estimate.

Everything is linear in the curves' coefficients but for the unknown directions of gravity, about
which it is repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from handcal.design.poses import MOUNTING
from handcal.effects import Effect, catalogue, select
from handcal.estimate.regression import BIASES
from handcal.lab.norm_rows import across, unit
from handcal.lab.steady_tests import design, of_arrays
from handcal.lab.thermal.basis import Basis
from handcal.lab.thermal.fit import Rows, best_extra, fitted
from handcal.lab.thermal.pieces import Pieces
from handcal.types import Array, IntArray

SENSORS = ("gyro", "accel")
# Usual change of a scale factor with temperature, 1/K: a hundredth of a per cent.
SCALE_SLOPE = 1e-4
ROUNDS = 12
LAST_STEP = 1e-13


@dataclass(frozen=True)
class Model:
    """A sensor's effects: constant ones, and which basis the changing ones have."""

    constant: tuple[Effect, ...]
    changing: tuple[tuple[Effect, Basis], ...]

    @property
    def usual(self) -> Array:
        """Standard deviations (k,) of the parameters beforehand: of constant effects, then for
        each changing one and each function those of its parameters."""
        out = [e.prior_sigma for e in self.constant]
        for effect, basis in self.changing:
            half = 0.5 * (basis.high - basis.low) * _slope(effect)
            out += [effect.prior_sigma, *[np.full(len(effect.parameters), half)] * (basis.size - 1)]
        return np.concatenate(out)


def _slope(effect: Effect) -> float:
    """Usual change of an effect's parameters by temperature, 1/K of their unit."""
    for bias, sensor in zip(BIASES, SENSORS, strict=True):
        if effect.id == bias.id:
            return catalogue()[f"{sensor}_temperature"].parameters[0].prior_sigma
    return SCALE_SLOPE


def models(sensor: str, pieces: Pieces, flat: Basis) -> Model:
    """Everything constant: bias, and scale and misalignment where they can matter."""
    bias = BIASES[SENSORS.index(sensor)]
    if sensor == "gyro" and pieces.known is None:
        return Model((), ((bias, flat),))
    scale, misaligned = select([f"{sensor}_scale", f"{sensor}_misalignment"])
    mounted = (MOUNTING,) if sensor == "accel" and pieces.known is not None else ()
    return Model((misaligned, *mounted), ((bias, flat), (scale, flat)))


def with_bases(model: Model, bases: Sequence[Basis]) -> Model:
    """The model with these curves for its parameters that change, in their order."""
    pairs = zip((e for e, _ in model.changing), bases, strict=True)
    return replace(model, changing=tuple(pairs))


@dataclass(frozen=True)
class Done:
    """x (k,), P (k, k) of a sensor's parameters, what is left (n, 3), extra noise."""

    x: Array
    P: Array
    left: Array
    extra: float

    @property
    def sigma(self) -> Array:
        return np.asarray(np.sqrt(np.diag(self.P)))


def directions(pieces: Pieces) -> Array:
    """Of the specific force in each rest (r, 3), from the readings."""
    r = int(pieces.rest.max()) + 1
    total = np.zeros((r, 3))
    np.add.at(total, pieces.rest, pieces.reading[:, 3:])
    return unit(total)


@dataclass(frozen=True)
class Scene:
    """A sensor's pieces about directions d (r, 3) of the force: y (n, 3) readings less truth,
    J (n, 3, k) their derivatives by the parameters. tangent (n, 3, 2): where the directions are
    unknown, what the readings change with them; it is eliminated rest by rest."""

    y: Array
    J: Array
    tangent: Array | None
    rest: IntArray
    variance: Array
    usual: Array

    def _groups(self) -> list[IntArray]:
        order = np.argsort(self.rest, kind="stable")
        cuts = np.flatnonzero(np.diff(self.rest[order])) + 1
        return [np.asarray(g, dtype=np.int64) for g in np.split(order, cuts)]

    def rows(self, x: Array) -> Rows:
        """About parameters x (k,), without the directions."""
        left = self.y - self.J @ x
        k = self.J.shape[2]
        if self.tangent is None:
            return Rows(left.ravel(), self.J.reshape(-1, k), self.variance.ravel(), self.usual, x)
        y, A, v = [], [], []
        for g in self._groups():
            Q = np.linalg.qr(self.tangent[g].reshape(-1, 2), mode="complete")[0][:, 2:]
            y.append(Q.T @ left[g].ravel())
            A.append(Q.T @ self.J[g].reshape(-1, k))
            v.append(np.full(Q.shape[1], self.variance[g[0], 0]))
        return Rows(np.concatenate(y), np.vstack(A), np.concatenate(v), self.usual, x)

    def turned(self, x: Array, d: Array) -> Array:
        """The directions (r, 3) that fit best with parameters x (k,)."""
        if self.tangent is None:
            return d
        left, out = self.y - self.J @ x, d.copy()
        for g in self._groups():
            r = self.rest[g[0]]
            turn = np.linalg.lstsq(self.tangent[g].reshape(-1, 2), left[g].ravel(), rcond=None)[0]
            out[r] += across(d[r : r + 1])[0] @ turn
        return unit(out)


def scene(model: Model, s: int, pieces: Pieces, gravity: float, d: Array) -> Scene:
    """Residuals and columns of one sensor (s: 0 gyro, 1 accelerometer) in the pieces, against the
    reference, or against gravity (m/s^2) along the directions d (rests, 3) alone."""
    n, own = len(pieces), slice(3 * s, 3 * s + 3)
    if pieces.known is None:
        accel = gravity * d[pieces.rest]
        gyro = np.zeros_like(accel)
    else:
        gyro, accel = pieces.known[:, :3], pieces.known[:, 3:]
    tests = of_arrays(gyro, accel, None, accel)
    parts = []
    for effect, basis in (*((e, None) for e in model.constant), *model.changing):
        J = design(tests, (effect,), np.zeros(len(effect.parameters)), tests.truth)[:, own]
        if basis is None:
            parts.append(J)
        else:
            parts += [f[:, None, None] * J for f in basis.values(pieces.T).T]
    loose = s == 1 and pieces.known is None
    return Scene(
        pieces.reading[:, own] - np.hstack([gyro, accel])[:, own], np.concatenate(parts, axis=2),
        gravity * across(d)[pieces.rest] if loose else None, pieces.rest,
        pieces.variance[:, own].reshape(n, 3), model.usual,
    )  # fmt: skip


def solved(model: Model, s: int, pieces: Pieces, gravity: float) -> Done:
    """The estimate, repeated about itself until nothing changes (Gauss-Newton)."""
    usual = model.usual
    x, d = np.zeros_like(usual), directions(pieces)
    last = np.inf
    for _ in range(ROUNDS):
        about = scene(model, s, pieces, gravity, d)
        rows = about.rows(x)
        extra = best_extra(rows)[0]
        new, P = fitted(rows, extra)
        size = float(np.abs((new - x) / usual).max())
        x, d = new, about.turned(new, d)
        if size < LAST_STEP or (size < 1e-9 and size >= last):
            break
        last = size
    about = scene(model, s, pieces, gravity, d)
    return Done(x, P, about.y - about.J @ x, extra)
