"""Paper 003 (Zhang, Li, Qin, Shen, 2017), formula by formula, and its printed numbers.

An accelerometer i has a direction of its own, row i of C (the paper's ``C_a^b`` transposed),
a scale k_i and a bias B_i: ``u_i = k_i (B_i + c_i . (f + W r_i))``, with W r the force that
turning adds at the place r. Forces are in g here, as in the paper's tables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handcal import regression, strapdown
from handcal.design_poses import HELD
from handcal.effects import Signals
from handcal.lab.size import ARMS, FACE_DIAGONALS
from handcal.types import Array

GRAVITY = 9.80665
# Table 1: bias, V; scale factor, V/g; installation angles to x, y, z, deg.
BIAS = np.array([2.405098, 2.380978, 2.435503])
SCALE = np.array([0.39496, 0.39808, 0.40024])
ANGLES = np.array(
    [[0.75997, 90.71425, 89.74038], [89.25516, 0.74486, 90.5630], [90.52202, 89.17706, 0.97456]]
)
# Table 3: place of each accelerometer, m.
PLACES = np.array(
    [[-0.00834, -0.00042, -0.00132], [-0.00256, -0.00893, -0.00026], [-0.00060, -0.00050, -0.00824]]
)
# Table 4: readings after compensation with x up and x down, g, and what they should be.
TABLE_4 = np.array([[0.998060, 0.000253, 0.002402], [-1.001939, 0.000253, 0.002402]])


@dataclass(frozen=True)
class Static:
    """The paper's 15 parameters of the static calibration: bias (3,), in units of the output;
    scale (3,), output per g; C (3, 3): direction cosines, row i of accelerometer i.

    Of the nine angles six are free: the squares of three direction cosines add up to one.
    """

    bias: Array
    scale: Array
    C: Array

    @property
    def angles(self) -> Array:
        """Installation angles (3, 3), deg."""
        return np.asarray(np.degrees(np.arccos(np.clip(self.C, -1.0, 1.0))))

    def sensed(self, u: Array) -> Array:
        """Forces along the sensors' own axes (n, 3), g, of outputs u (n, 3)."""
        return np.asarray((u - self.bias) / self.scale)

    def force(self, u: Array) -> Array:
        """Specific force (n, 3), g, of outputs u (n, 3): equation 6, with the inverse of C."""
        return np.asarray(np.linalg.solve(self.C, self.sensed(u).T).T)

    def transposed(self, u: Array) -> Array:
        """The same as if C were orthogonal, which it is not (equation 4)."""
        return np.asarray(self.sensed(u) @ self.C)


def static(u: Array, f: Array) -> Static:
    """Static calibration from outputs u (n, 3) under known forces f (n, 3), g, by least squares."""
    A = np.c_[np.ones(len(f)), f]
    x = np.array([regression.least_squares(A, own).x for own in u.T])
    scale = np.linalg.norm(x[:, 1:], axis=1)
    return Static(x[:, 0], scale, x[:, 1:] / scale[:, None])


def cosines(angles: Array, mended: bool = True) -> Array:
    """Direction cosines (3, 3) of printed angles, deg; mended: each row of length one, by the
    angle to its own axis, which is the one misprinted."""
    C = np.cos(np.radians(angles))
    if mended:
        off = ~np.eye(3, dtype=bool)
        C[~off] = np.sqrt(1.0 - (C**2 * off).sum(axis=1))
    return np.asarray(C)


def swing(omega: Array) -> Array:
    """W (n, 3, 3) of steady turns omega (n, 3) rad/s: a place r is pushed by W r, m/s^2.

    It is the catalogue's size effect, with all three accelerometers in one place.
    """
    held = np.repeat(omega, HELD, axis=0)
    signals = Signals(np.arange(float(len(held))), held, np.zeros_like(held))
    J = regression.columns(ARMS, np.zeros(9), signals)[HELD // 2 :: HELD, 3:]
    return np.asarray(np.stack([J[:, i, 3 * i : 3 * i + 3] for i in range(3)], axis=1))


def outputs(s: Static, f: Array, omega: Array, places: Array) -> Array:
    """Outputs u (n, 3) under forces f (n, 3), g, while turning at omega (n, 3), rad/s."""
    pushed = np.einsum("ij,njk,ik->ni", s.C, swing(omega), places) / GRAVITY
    return np.asarray(s.bias + s.scale * (f @ s.C.T + pushed))


def arms(C: Array, change: Array, omega: Array) -> tuple[Array, Array]:
    """Places (3, 3), m, and for a change known to 1 m/s^2 their sigmas (3, 3), by least squares.

    change (n, 3): what the forces sensed in a spin exceed those of the rest before it, m/s^2;
    omega (n, 3) rad/s.
    """
    found = [regression.least_squares(np.einsum("j,njk->nk", c, swing(omega)), own)
             for c, own in zip(C, change.T, strict=True)]  # fmt: skip
    return np.array([f.x for f in found]), np.array([f.sigma for f in found])


def equation_24(C: Array, spin: Array, rest: Array, omega_0: float) -> Array:
    """Places (3, 3), m, from spins about x, y and z, each with its axis up, as in equation 24
    with its misprint mended: spin, rest (3, 3), m/s^2, row: axis; omega_0 rad/s.

    Printed, the fourth term of each line repeats the first, which then drops out.
    """
    x, y, z = spin - rest
    own = np.stack([x - y - z, y - x - z, z - x - y], axis=1)
    return np.asarray(own / (2.0 * omega_0**2 * C))


def equation_24_printed(C: Array, spin: Array, rest: Array, omega_0: float) -> Array:
    """The first line of equation 24 as it is printed, for all three accelerometers: (3,), m."""
    x, y, z = spin
    _, y0, z0 = rest
    return np.asarray((x - y - z - x + z0 + y0) / (2.0 * omega_0**2 * C[:, 0]))


@dataclass(frozen=True)
class Drift:
    """Largest errors of a run of dead reckoning: speed m/s, distance m."""

    speed: float
    distance: float


def reckoned(t: Array, angle: Array, error: Array) -> Drift:
    """Dead reckoning of a body turned about the vertical by angle (n,) rad at t (n,) s, its
    forces read too large by error (n, 3) m/s^2 in its own axes; attitude known exactly."""
    rate = np.gradient(angle, t, edge_order=2)
    omega = np.stack([np.zeros_like(t), np.zeros_like(t), rate], axis=1)
    up = np.array([0.0, 0.0, GRAVITY])
    g_n, none = np.array([0.0, 0.0, -GRAVITY]), np.zeros(3)
    p, v, _ = strapdown.integrate(t, omega, error + up, none, none, np.eye(3), g_n, none)
    return Drift(float(np.linalg.norm(v, axis=1).max()), float(np.linalg.norm(p, axis=1).max()))


def pushed(t: Array, angle: Array, places: Array) -> Array:
    """What accelerometers at these places (3, 3), m, read too much (n, 3), m/s^2."""
    omega = np.zeros((len(t), 3))
    omega[:, 2] = np.gradient(angle, t, edge_order=2)
    return regression.errors(ARMS, places.ravel(), Signals(t, omega, np.zeros_like(omega)))[:, 3:]


def found_places(sigma: float, rate: float, rng: np.random.Generator) -> Array:
    """Places (3, 3), m, from six spins about the diagonals of the faces at a rate, rad/s, and
    rests before them, each reading with noise sigma, m/s^2; truth: tables 1 and 3."""
    C = cosines(ANGLES)
    device = Static(BIAS, SCALE, C)
    omega = rate * FACE_DIAGONALS
    read = [GRAVITY * device.sensed(outputs(device, FACE_DIAGONALS, w, PLACES))
            + sigma * rng.standard_normal(omega.shape) for w in (omega, 0.0 * omega)]  # fmt: skip
    return arms(C, read[0] - read[1], omega)[0]
