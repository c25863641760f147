"""Paper 004 (Fang, Chou, Ding: An Optimal Calibration Method for a MEMS Inertial Measurement Unit).

Each axis i reads ``b_i + P_i . input`` with a known input of length r; a design matrix has rows
(input, 1), and det(F' F / n) is to be large. For unit inputs no design has more than 1/27.
"""

from __future__ import annotations

import math

import numpy as np

from handcal.allan import overlapping
from handcal.design.poses import experiment
from handcal.design.search import design
from handcal.estimate import regression
from handcal.lab.papers.paper import CORRECTED, FAILS, HOLDS, UNKNOWN, Claim, Paper, Progress, below
from handcal.types import Array

# Table 2, directions of the input.
H = math.sqrt(0.5)
NINE = np.array([[1, 0, 0], [-1, 0, 0], [H, H, 0], [H, 0, H], [0, 1, 0], [0, -1, 0], [0, H, H],
                 [0, 0, 1], [0, 0, -1]])  # fmt: skip
SIX = NINE[[0, 1, 4, 5, 7, 8]]
# Equations 26 to 28: the four positions of each axis's filter, as numbers of table 2.
BANK = ((0, 1, 2, 3), (4, 5, 2, 6), (7, 8, 6, 3))
# Table 3: theta x, y, z; beta yz, zy, zx; and noise.
THETA, BETA = (0.01, 0.05, 0.1), (0.5, 0.5, 0.8)
BIAS, SCALE, NOISE = np.array([2.0, 2.5, 2.9]), np.array([0.01, 0.05, 0.09]), 1e-3
# Table 4: the same angles of accelerometer and gyro, deg.
ANGLES_4 = (((0.06, 0.20, 0.19), (0.01, -0.02, -0.01)), ((-0.18, 0.05, 0.15), (1.32, 1.05, 1.15)))
SAMPLES, RUNS = 200, 200
LARGEST = 1.0 / 27.0
REACHED = (4, 6, 9, 10, 12, 13)


def rows(inputs: Array) -> Array:
    """Design matrix (n, 4) for inputs (n, 3): bias first, as in equations 26 to 28."""
    return np.hstack([np.ones((len(inputs), 1)), inputs])


def determinant(inputs: Array) -> float:
    """det(F' F / n): the paper's equation 22."""
    F = rows(inputs)
    return float(np.linalg.det(F.T @ F / len(F)))


def efficiency(inputs: Array) -> float:
    """D-efficiency against the largest determinant there is."""
    return float((determinant(inputs) / LARGEST) ** 0.25)


def misalignment(theta: Array, beta: Array) -> tuple[Array, Array]:
    """M of equation 14 as the product that it stands for, and as printed in its last line."""
    x, y, z = theta
    yz, zy, zx = beta
    M_p = np.array([[1, -z, y], [z, 1, -x], [-y, x, 1]])
    M_o = np.array([[1, 0, 0], [yz, 1, 0], [-zy, zx, 1]])
    return M_o @ M_p, np.array([[1, -z, y], [yz + z, 1, -x], [-zy - y, zx + x, 1]])


def true_bank() -> Array:
    """Bias and P (3, 4) of each axis, as table 3 has them."""
    P = SCALE[:, None] * misalignment(np.array(THETA), np.array(BETA))[1]
    return np.hstack([BIAS[:, None], P])


def measured(axis: int, rng: np.random.Generator, samples: int = SAMPLES) -> tuple[Array, Array]:
    """Rows and readings of an axis's filter, divided by the noise."""
    A = np.repeat(rows(NINE[list(BANK[axis])]), samples, axis=0)
    y = A @ true_bank()[axis] + NOISE * rng.standard_normal(len(A))
    return A / NOISE, y / NOISE


def bank(rng: np.random.Generator) -> tuple[Array, Array]:
    """The paper's three Kalman filters, and least squares on the same readings: x (3, 4)."""
    data = [measured(axis, rng) for axis in range(3)]
    filtered = np.array([regression.kalman(A, y)[0] for A, y in data])
    return filtered, fitted(data)


def fitted(data: list[tuple[Array, Array]]) -> Array:
    """Least squares x (3, 4) of each axis's rows and readings."""
    return np.array([regression.least_squares(A, y).x for A, y in data])


def sigmas(inputs: Array, readings: int) -> Array:
    """Standard deviations (4,) of bias and P of an axis from so many readings, spread evenly over
    the positions, in units of a reading's."""
    A = rows(inputs) * math.sqrt(readings / len(inputs))
    return regression.least_squares(A, np.zeros(len(A))).sigma


def allan_as_printed(x: Array, n: int) -> float:
    """Equation 6: means of n readings from every reading on, x (N,)."""
    total = np.concatenate([[0.0], np.cumsum(x)])
    mean = (total[n:] - total[:-n]) / n
    apart = mean[n:] - mean[:-n]
    return float((apart**2).sum() / (2.0 * (len(x) - 2 * n)))


def _overlapping() -> float:
    """Equation 6 against the usual overlapping estimator, relative."""
    x = np.random.default_rng(0).standard_normal(2000)
    deviation = overlapping.deviation(x, 1.0, np.array([50.0]))
    return float(allan_as_printed(x, 50) / deviation[0] ** 2 - 1.0)


def best_determinants() -> dict[int, float]:
    """The determinant of handcal's own designs with so many positions."""
    e = experiment(("accel_scale", "accel_misalignment"), "pose")
    return {n: determinant(design(e, n, "D", np.random.default_rng(0), starts=2).up)
            for n in REACHED}  # fmt: skip


def paper(progress: Progress) -> Paper:
    """All of it, computed again."""
    own = best_determinants()
    progress(0.8)
    filtered, by_squares = bank(np.random.default_rng(0))
    off = np.array([
        fitted([measured(axis, rng, samples=10) for axis in range(3)]) - true_bank()
        for rng in map(np.random.default_rng, range(RUNS))
    ])  # fmt: skip
    progress(1.0)
    moments = len(NINE) * SAMPLES
    used = len(BANK[0]) * SAMPLES
    beyond = (
        ("determinant with 4, 6, 9, 10, 12, 13 positions; 1/27 is the most",
         f"{determinant(NINE):.4f} (9)",
         "27 det = " + ", ".join(f"{27.0 * d:.4f}" for d in own.values())),
        (f"{moments} readings of each axis, noise 1: sigma of bias, P11, P12, P13; nine positions "
         "of table 2, and six", _list(sigmas(NINE, moments)), _list(sigmas(SIX, moments))),
        (f"the same where the filter of an axis takes its four positions ({used} readings), and "
         "six", _list(sigmas(NINE[list(BANK[0])], used)), _list(sigmas(SIX, moments))),
    )  # fmt: skip
    source = "Fang, Chou, Ding: An Optimal Calibration Method for a MEMS IMU, IJARS 2014"
    claims = (*_design_claims(), *_filter_claims(filtered - by_squares, off), *_other_claims())
    return Paper("004", source, claims, beyond)


def _design_claims() -> list[Claim]:
    four = NINE[list(BANK[0])]
    rank = np.linalg.matrix_rank(rows(SIX))
    return [
        Claim("the nine positions of table 2 are D-optimal", "optimal",
              f"det {determinant(NINE):.4f} against 1/27 = {LARGEST:.4f}: efficiency "
              f"{efficiency(NINE):.3f}", FAILS),
        Claim("four optimal positions for each axis", "optimal",
              f"efficiency of the printed rows {efficiency(four):.3f}", FAILS),
        Claim("the traditional six positions are worse", "an order of magnitude",
              f"efficiency {efficiency(SIX):.3f}: better than both, and the best there is", FAILS),
        Claim("six positions cannot show misalignments", "cannot",
              f"rank {rank} of 4 for each axis: they do", FAILS),
        Claim("the positions show all twelve parameters", "rank 4 for each axis",
              f"rank {min(np.linalg.matrix_rank(rows(NINE[list(b)])) for b in BANK)} of 4", HOLDS),
    ]  # fmt: skip


def _filter_claims(apart: Array, off: Array) -> list[Claim]:
    same = below(float(np.abs(apart).max()))
    mean = np.abs(off.mean(axis=0) / (off.std(axis=0, ddof=1) / math.sqrt(len(off))))
    return [
        Claim("a bank of Kalman filters is better than least squares", "figures 4 to 7",
              f"on the same readings, Joseph form: equal {same}", FAILS),
        Claim("least squares gives biased estimates", "biased",
              f"mean of {len(off)} runs: at most {mean.max():.1f} standard errors from the truth "
              "in twelve parameters", FAILS),
    ]  # fmt: skip


def _other_claims() -> list[Claim]:
    product, printed = misalignment(np.array(THETA), np.array(BETA))
    loss = [float(np.abs(np.subtract(*misalignment(*np.radians(a)))).max()) for a in ANGLES_4]
    return [
        Claim("equation 14: M as a sum of angles", "approximately",
              f"off by {np.abs(product - printed).max():.2f} at table 3, by {min(loss):.0e} to "
              f"{max(loss):.0e} at table 4", CORRECTED),
        Claim("equation 6 is the Allan variance, equation 8 the overlapping one", "two estimators",
              f"equation 6 as summed, over every k, overlaps already: {abs(_overlapping()):.1e} "
              "from the overlapping one (its divisor is one less)", CORRECTED),
        Claim("biases of table 4", "1.66 to 1.79 m/s², 2.5 °/s",
              "volts: the sensors' 1.65 V and 2.5 V at zero", CORRECTED),
        Claim("thermal calibration", "figures without numbers", "–", UNKNOWN),
    ]  # fmt: skip


def _list(x: Array) -> str:
    return ", ".join(f"{v:.4f}" for v in x)
