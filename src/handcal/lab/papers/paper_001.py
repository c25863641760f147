"""Paper 001 (scalar calibration of three accelerometers at optimal orientations).

The paper's method: the squared length of the readings less that of gravity is linear in nine
small deviations, with rows for the orientations as commanded; solved once. SI units, as the
paper's condition numbers have it. Gimbals Y, X, Z from the base; gravity along the base's Y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from handcal.design.poses import Experiment, experiment
from handcal.design.search import all_at_once, design, judged, one_by_one
from handcal.estimate.regression import least_squares
from handcal.lab.papers.paper import CORRECTED, FAILS, HOLDS, UNKNOWN, Claim, Paper, Progress, below
from handcal.lab.papers.table import Table
from handcal.lab.scalar import from_poses
from handcal.lab.table import ARCMIN, ARCSEC
from handcal.types import Array

GRAVITY = 9.815
EFFECTS = ("accel_scale", "accel_misalignment")
# Table 2, deg: gimbals Z, X, Y.
TABLE_2 = np.array([
    [0, 0, 0], [90.0074, -89.9926, 90.0], [-90.0, 0.5947, 0.5947], [-136.0061, 35.6601, 77.0549],
    [138.6793, 36.9652, -83.1103], [50.5226, 33.2264, -16.0279], [135.177, -34.32, 73.648],
    [-136.926, -34.5039, -76.3967], [-43.8877, 36.9528, 15.3341],
])  # fmt: skip
# Table 1, deg, in the same order: gimbals Z, X, Y.
TABLE_1 = np.outer(np.arange(9.0), [40.0, 40.0, 10.0])
# Table 3: each axis leans by 10' towards each of the others, scales 0.5 %, biases 1e-3 m/s^2.
# The signs are those with which the paper's 0.86 % comes out.
LEAN = 10.0 * ARCMIN * (np.eye(3) - 1.0)
SCALE, BIAS = 0.005, 1e-3
ANGLE = 600.0 * ARCSEC
RUNS, ITERATED, STARTS = 200, 20, 6
READING = 1e-4 * GRAVITY


@dataclass(frozen=True)
class Errors:
    """Mean relative errors of angles, scales and biases."""

    angle: float
    scale: float
    bias: float


def force(gimbals: Array) -> Array:
    """Gravity (..., 3), m/s^2, in the axes of the module at gimbal angles Z, X, Y (..., 3), rad.

    The outer gimbal turns about gravity and changes nothing.
    """
    z, x = gimbals[..., 0], gimbals[..., 1]
    f = [np.cos(x) * np.sin(z), np.cos(x) * np.cos(z), -np.sin(x)]
    return np.asarray(GRAVITY * np.stack(f, axis=-1))


def gimbals_of(up: Array) -> Array:
    """Gimbal angles Z, X, Y (n, 3), rad, that bring directions up (n, 3) to the vertical."""
    z, x = np.arctan2(up[:, 0], up[:, 1]), -np.arcsin(np.clip(up[:, 2], -1.0, 1.0))
    return np.stack([z, x, np.zeros(len(up))], axis=1)


def rows(f: Array) -> Array:
    """Rows (n, 9) of the paper's equation 8 for forces f (n, 3): by the three angles between
    axes (xy, xz, yz), the three scales, the three biases."""
    x, y, z = f.T
    return 2.0 * np.stack([x * y, x * z, y * z, x * x, y * y, z * z, x, y, z], axis=1)


def condition(up: Array) -> float:
    """Condition number of A' A, SI, for directions up (n, 3): the paper's figure."""
    A = rows(GRAVITY * up)
    return float(np.linalg.cond(A.T @ A))


def readings(f: Array) -> Array:
    """What the accelerometers of table 3 read (..., 3) under forces f (..., 3)."""
    S = (1.0 + SCALE) * (np.eye(3) + LEAN)
    return np.asarray(f @ S.T + BIAS)


def linear(gimbals: Array, u: Array) -> Array:
    """The paper's estimate (9,): one solution, rows for the gimbal angles (n, 3) as commanded."""
    missed = (u**2).sum(axis=1) - GRAVITY**2
    return least_squares(rows(force(gimbals)), missed).x


def iterated(u: Array, sigma: float = 1e-11) -> Array:
    """handcal's estimate from the readings alone, as the same nine numbers.

    The catalogue's misalignments have accelerometer x for body x; the angle between two axes
    is what both agree on, and so is each axis's own sensitivity.
    """
    _, x, _ = from_poses(u, EFFECTS, GRAVITY, sigma)
    M = np.eye(3) + np.diag(x[3:6])
    M[1, 0], M[2, 0], M[2, 1] = x[6:9]
    return _described(M, x[:3])


def _described(M: Array, bias: Array) -> Array:
    """Angles between axes (3,), scales (3,), biases (3,) of the matrix M (3, 3) of a triad."""
    length = np.linalg.norm(M, axis=1)
    cos = (M / length[:, None]) @ (M / length[:, None]).T
    angles: Array = np.arcsin(cos[[0, 0, 1], [1, 2, 2]])
    return np.concatenate([angles, length - 1.0, bias])


def truth() -> Array:
    """The nine numbers of table 3."""
    return _described((1.0 + SCALE) * (np.eye(3) + LEAN), np.full(3, BIAS))


def relative(x: Array, about: Array) -> Errors:
    """Mean relative errors of estimates x (..., 9)."""
    off = np.abs(x / about - 1.0)
    return Errors(*(float(off[..., s].mean()) for s in (slice(0, 3), slice(3, 6), slice(6, 9))))


def floor() -> Errors:
    """The paper's estimate at table 2 with every angle exact: what linearising leaves."""
    g = np.radians(TABLE_2)
    return relative(linear(g, readings(force(g))), _linear_truth())


def _linear_truth() -> Array:
    """The nine deviations that the paper's linear model is about: first order in table 3."""
    angles = 2.0 * LEAN[[0, 0, 1], [1, 2, 2]]
    return np.concatenate([angles, np.full(3, SCALE), np.full(3, BIAS)])


def imitation(
    sets: list[Array], sigma: float, rng: np.random.Generator, alike: bool, runs: int = RUNS
) -> list[Errors]:
    """Errors of the paper's estimate for sets of gimbal angles (n, 3), rad, on the same draws:
    sigma of each angle, rad; alike: the three angles of a pose are wrong by the same."""
    off = sigma * rng.standard_normal((runs, 9, 1 if alike else 3))
    return [
        relative(np.array([linear(g, readings(force(g + o))) for o in off]), _linear_truth())
        for g in sets
    ]


def imitation_iterated(
    sets: list[Array], sigma: float, rng: np.random.Generator, noise: float, runs: int = ITERATED
) -> list[Errors]:
    """The same of handcal's estimate; noise of a mean reading, m/s^2."""
    off = sigma * rng.standard_normal((runs, 9, 3))
    read = noise * rng.standard_normal((runs, 9, 3))
    return [
        relative(np.array([iterated(readings(force(g + o)) + w, max(noise, 1e-11))
                           for o, w in zip(off, read, strict=True)]), truth())
        for g in sets
    ]  # fmt: skip


def triad() -> Experiment:
    """What poses tell when only the size of gravity is known."""
    return experiment(EFFECTS, "norm")


def up_of(table: Array) -> Array:
    """Directions up (n, 3) of gimbal angles in degrees."""
    return force(np.radians(table)) / GRAVITY


def own_poses(n: int) -> Array:
    """The n directions (n, 3) with the largest determinant."""
    return design(triad(), n, "D", np.random.default_rng(0)).up


def paper(progress: Progress) -> Paper:
    """All of it, computed again."""
    e = triad()
    rng = np.random.default_rng(0)
    own = {n: own_poses(n) for n in (9, 10, 12)}
    progress(0.4)
    efficiency = [judged(e, up, "D", "given", rng).d_efficiency
                  for up in (up_of(TABLE_2), *own.values())]  # fmt: skip
    sets = [np.radians(TABLE_2), gimbals_of(own[9])]
    alike = imitation(sets, ANGLE, np.random.default_rng(0), alike=True)
    apart = imitation(sets, ANGLE, np.random.default_rng(1), alike=False)
    progress(0.6)
    exact = imitation_iterated(sets, ANGLE, np.random.default_rng(2), 0.0)
    noisy = imitation_iterated(sets, ANGLE, np.random.default_rng(3), READING, RUNS)
    progress(1.0)
    beyond = (
        ("D-efficiency: table 2; own nine, ten and twelve poses", f"{efficiency[0]:.3f}",
         ", ".join(f"{x:.3f}" for x in efficiency[1:])),
        ("angle errors without any error of position", _percent(floor().angle),
         f"{below(exact[0].angle)}, iterated: the floor is gone"),
        ("scale, bias errors at 600 arcsec: table 2, linear; own nine, iterated (a pose need not "
         "be known)", _both(alike[0]), below(max(exact[1].scale, exact[1].bias))),
        ("the design alone, linear on the same draws, each axis wrong by itself", _both(apart[0]),
         _both(apart[1])),
        ("the design alone, linear, the axes of a pose wrong alike", _both(alike[0]),
         _both(alike[1])),
        ("the design alone, iterated, readings good to 0.1 mg", _both(noisy[0]), _both(noisy[1])),
    )  # fmt: skip
    # (the text at hand names neither authors nor year)
    source = "Scalar calibration of an accelerometer module at optimal orientations, 2019 or later"
    return Paper("001", source, _claims(e, alike[0]), beyond, (_poses_table(own[9]),))


def _claims(e: Experiment, two: Errors) -> tuple[Claim, ...]:
    second, rng = up_of(TABLE_2), np.random.default_rng(0)
    in_si = replace(e, scale=np.ones_like(e.scale))
    least = all_at_once(in_si, 9, "condition", rng, STARTS)
    (worse,) = imitation([gimbals_of(least)], ANGLE, np.random.default_rng(0), alike=True)
    return (
        Claim("table 2: condition number", "263.6104",
              f"{condition(second):.2f} (of A' A, SI, g = 9.815)", HOLDS),
        Claim("table 1: condition number", "3.3e4",
              "singular in the same convention" if condition(up_of(TABLE_1)) > 1e15 else
              f"{condition(up_of(TABLE_1)):.1e}", UNKNOWN),
        Claim("the next pose: least projection on the rows there are", "263.6104 after nine",
              f"{condition(one_by_one(e, 9)):.0f} with rows of length one", HOLDS),
        Claim("the smaller this condition number, the better the poses", "263.6104",
              f"the smallest there is, {condition(least):.0f}, has D-efficiency "
              f"{judged(e, least, 'D', 'given', rng).d_efficiency:.3f} and scale errors of "
              f"{_percent(worse.scale)} at 600 arcsec: in SI it compares biases with scales by the "
              f"unit of force (in g, table 2 has {_in_g(second):.2f})", FAILS),
        Claim("error of the angles, whatever the errors of position", "0.86 %",
              f"{_percent(floor().angle)} with no error of position at all: what is left of the "
              "linearisation", CORRECTED),
        Claim("error of the scales at 600 arcsec", "0.4 %", _percent(two.scale), HOLDS),
        Claim("error of the biases at 600 arcsec", "7.5 %", _percent(two.bias), HOLDS),
    )  # fmt: skip


def _both(errors: Errors) -> str:
    return f"{_percent(errors.scale)}, {_percent(errors.bias)}"


def _in_g(up: Array) -> float:
    A = rows(up)
    return float(np.linalg.cond(A.T @ A))


def _poses_table(up: Array) -> Table:
    lines = tuple((f"{i + 1}", *(f"{math.degrees(math.asin(v)):.1f}".replace("-", "−") for v in u))
                  for i, u in enumerate(np.clip(up, -1.0, 1.0)))  # fmt: skip
    columns = ("pose", "x up by, deg", "y up by, deg", "z up by, deg")
    return Table("Nine poses of the largest determinant", columns, lines)


def _percent(part: float) -> str:
    return f"{100.0 * part:.2g} %"
