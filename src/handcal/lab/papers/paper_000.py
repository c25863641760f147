"""Paper 000 (Avrutov, Aksonenko, Henaff, Ciarletta: 3D-Calibration of the IMU, 2017).

Its four samples in the paper's own units (V, g, deg/s): a reading is B + K input + L products,
which is the catalogue's bias, scale (K - 1), misalignments and cross products in the table's axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from handcal.effects import select
from handcal.estimate.regression import BIASES
from handcal.lab.known_input import KnownInput, known_input
from handcal.lab.papers.paper import CORRECTED, FAILS, HOLDS, Claim, Paper, Progress, below
from handcal.lab.papers.table import Table as Shown
from handcal.lab.steady_tests import Bench, of_arrays
from handcal.lab.table import ARCMIN, ARCSEC, Table, error_covariance, table
from handcal.lab.ten_tests import best_rates, magnification
from handcal.types import Array, HandcalError

EXACT = {"gyro": 0.0, "accel": 0.0}
STEP_DEG, POSITIONS = 10.0, 41
ACCEL_BIAS, GYRO_BIAS = 2.5, 2.0
K_ACCEL = np.array([[1.0, 0.01, -0.01], [-0.01, 1.0, 0.01], [0.01, -0.01, 1.0]])
# n11 is printed as 0.01 in sample 3 and taken for 1.0 in its result; its neighbours are 0.1.
K_GYRO = np.array([[0.1, 0.01, -0.02], [-0.01, 0.1, 0.01], [0.03, -0.01, 0.1]])
K_GYRO_4 = np.array([[0.01, 0.01, -0.02], [-0.01, 0.1, 0.01], [0.03, -0.01, 0.1]])
PRODUCTS = 1e-3 * (1.0 - 2.0 * np.eye(3))
# Result of sample 4 as printed: columns are axes, rows B, K^T, L^T.
PRINTED_4 = np.array([
    [2, 2, 2], [0.01, -0.01, 0.03], [0.01, 0.1, -0.01], [-0.02, 0.01, 0.1],
    [-0.001, 0.001, 0.001], [0.001, 0.001, -0.001], [0.001, -0.001, 0.001],
])  # fmt: skip
RUNS = 20_000
MILLIVOLT = 1e-3


@dataclass(frozen=True)
class Sample:
    """Tests, and what comes out if all is right: X (c, 3), rows B, K^T and L^T."""

    bench: Bench
    effects: tuple[str, ...]
    X: Array


def sequences() -> list[str]:
    """The twelve sequences of three axes."""
    all_three = ("".join(s) for s in product("XYZ", repeat=3))
    return [s for s in all_three if s[0] != s[1] and s[1] != s[2]]


def poses(sequence: str = "ZXZ") -> Table:
    """41 positions, all three angles from 0 to 400 deg; gravity is 1 g."""
    angle = np.radians(STEP_DEG * np.arange(POSITIONS))
    return table(sequence, np.repeat(angle[:, None], 3, axis=1), 1.0)


def products(x: Array) -> Array:
    """Products xy, yz, xz (n, 3)."""
    return x[:, [0, 1, 0]] * x[:, [1, 2, 2]]


def accelerometers(sequence: str = "ZXZ", pendulous: bool = False) -> Sample:
    """Samples 1 and 2."""
    f = poses(sequence).force()
    ids: tuple[str, ...] = ("accel_scale", "accel_misalignment")
    U = ACCEL_BIAS + f @ K_ACCEL.T
    X = np.vstack([np.full((1, 3), ACCEL_BIAS), K_ACCEL.T])
    if pendulous:
        ids, U, X = (*ids, "accel_cross_products"), U + products(f) @ PRODUCTS.T, _with(X)
    return Sample(of_arrays(None, f, None, U), ids, X)


def gyros(rates: Array, extended: bool = False) -> Sample:
    """Samples 3 and 4 at these rates (n, 3), deg/s."""
    K = K_GYRO_4 if extended else K_GYRO
    ids: tuple[str, ...] = ("gyro_scale", "gyro_misalignment")
    U = GYRO_BIAS + rates @ K.T
    X = np.vstack([np.full((1, 3), GYRO_BIAS), K.T])
    if extended:
        ids, U, X = (*ids, "gyro_cross_products"), U + products(rates) @ PRODUCTS.T, _with(X)
    return Sample(of_arrays(rates, None, U, None), ids, X)


def _with(X: Array) -> Array:
    return np.vstack([X, PRODUCTS.T])


def rates_3() -> Array:
    """Sample 3, 11 tests, the first axis as it must be meant (printed: y twice)."""
    w = 10.0 * np.arange(11)
    return np.stack([w, np.sqrt(w), np.cbrt(w)], axis=1)


def rates_4() -> Array:
    """Sample 4, 11 tests."""
    w = np.arange(11.0)
    return np.stack([w, np.exp(-w), w**2], axis=1)


def solved(sample: Sample) -> tuple[KnownInput, Array]:
    """The calibration, and X (c, 3) from it."""
    result = known_input(sample.bench, sample.effects, "table", EXACT)
    return result, solution(result)


def solution(result: KnownInput, values: Array | None = None) -> Array:
    """X (c, 3) of a calibration in the table's axes: rows B, K^T, L^T; values (k,): others in
    the place of the parameters', without the 1 in K (standard deviations)."""
    at = {(p.effect.split("_", 1)[1], p.name): i for i, p in enumerate(result.parameters)}
    x = result.x if values is None else values
    X = np.zeros((7 if ("cross_products", "x_xy") in at else 4, 3))
    for j, axis in enumerate("xyz"):
        X[0, j] = x[at["bias", axis]]
        for i, other in enumerate("xyz"):
            name = ("scale", axis) if i == j else ("misalignment", axis + other)
            X[1 + i, j] = x[at[name]] + (i == j and values is None)
        for i, pair in enumerate(("xy", "yz", "xz")[: len(X) - 4]):
            X[4 + i, j] = x[at["cross_products", f"{axis}_{pair}"]]
    return X


def plain_condition(sample: Sample) -> float:
    """Condition number of the paper's matrix G, in its units."""
    truth = sample.bench.mean(np.hstack([sample.bench.truth.gyro, sample.bench.truth.accel]))
    x = truth[:, :3] if sample.bench.used[0] else truth[:, 3:]
    G = np.c_[np.ones(len(x)), x]
    return float(np.linalg.cond(np.c_[G, products(x)] if len(sample.X) == 7 else G))


def monte_carlo(
    angle: float, tilt: float, rng: np.random.Generator, runs: int = RUNS
) -> tuple[Array, Array, Array]:
    """Standard deviations (4, 3) of X in sample 1 that errors of the table bring: in so many
    runs, by the formula with the correlations, and without."""
    where = poses()
    result, _ = solved(accelerometers())
    G = np.linalg.pinv(np.c_[np.ones(POSITIONS), where.force()])
    errors = (
        angle * rng.standard_normal((runs, POSITIONS, 3)),
        tilt * rng.standard_normal((runs, 2)),
    )
    U = ACCEL_BIAS + where.force(*errors) @ K_ACCEL.T
    spread = (G @ U).std(axis=0)
    formula = [solution(result, np.sqrt(np.diag(error_covariance(result, where, angle, tilt, k))))
               for k in (True, False)]  # fmt: skip
    return spread, formula[0], formula[1]


def ten_tests(extended: bool) -> tuple[Array, float]:
    """Ten rates (10, 3), deg/s, no faster than the sample's fastest, and how many times less than
    in the sample they magnify noise in the coefficient that suffers most there."""
    rates = rates_4() if extended else rates_3()
    ids = ["gyro_scale", "gyro_misalignment", *(["gyro_cross_products"] if extended else [])]
    effects = [BIASES[0], *select(ids)]
    better = best_rates(effects, float(rates.max()))
    there, here = magnification(effects, rates), magnification(effects, better)
    worst = int(np.argmax(there))
    return better, float(there[worst] / here[worst])


def uncertain(sample: Sample) -> Array:
    """Standard deviations of K (3, 3) for 1 mV of noise, as parts of the coefficients."""
    result, _ = solved(sample)
    sigma = solution(result, MILLIVOLT * np.sqrt(np.diag(result.covariance)))
    return np.asarray((sigma[1:4] / np.abs(sample.X[1:4])).T)


def paper(progress: Progress) -> Paper:
    """All of it, computed again."""
    claims = [*_accelerometer_claims()]
    progress(0.2)
    claims += _gyro_claims()
    progress(0.5)
    claims += _error_claims()
    progress(1.0)
    (three, gain_3), (four, gain_4) = ten_tests(False), ten_tests(True)
    beyond = (
        ("rates that do not determine the parameters", "rank condition",
         "refused, naming what no reading shows" if _refused() else "accepted"),
        ("n13 with 1 mV of noise, rates as in sample 3 and ten better ones",
         _percent(uncertain(gyros(rates_3()))[0, 2]), _percent(uncertain(gyros(three))[0, 2])),
        ("noise magnified less than in sample 3, worst coefficient", "1", f"{gain_3:.0f} times"),
        ("noise magnified less than in sample 4, worst coefficient", "1", f"{gain_4:.0f} times"),
    )  # fmt: skip
    more = tuple(_rates_table(n, t) for n, t in ((3, three), (4, four)))
    source = "Avrutov, Aksonenko, Henaff, Ciarletta: 3D-Calibration of the IMU, ELNANO 2017"
    return Paper("000", source, tuple(claims), beyond, more)


def _off(sample: Sample) -> float:
    return float(np.abs(solved(sample)[1] - sample.X).max())


def _kalman_off(samples: list[Sample]) -> float:
    return max(solved(s)[0].kalman for s in samples)


def _accelerometer_claims() -> list[Claim]:
    claims = []
    for number, pendulous in ((1, False), (2, True)):
        conds = {s: plain_condition(accelerometers(s, pendulous)) for s in sequences()}
        best, worst = min(conds, key=lambda s: conds[s]), max(conds, key=lambda s: conds[s])
        off = max(_off(accelerometers(s, pendulous)) for s in sequences())
        claims.append(
            Claim(
                f"sample {number}: all coefficients recovered from 40 positions",
                "to six digits",
                f"41 positions; {below(off)} V for all twelve sequences of axes; condition number "
                f"{conds[best]:.1f} ({best}) to {conds[worst]:.1f} ({worst})",
                HOLDS,
            )
        )
    return claims


def _gyro_claims() -> list[Claim]:
    s3, s4 = gyros(rates_3()), gyros(rates_4(), True)
    swapped = s4.X[[0, 1, 2, 3, 4, 6, 5]]
    alike = _kalman_off([accelerometers(), accelerometers(pendulous=True), s3, s4])
    loss_3, loss_4 = uncertain(s3), uncertain(s4)
    return [
        Claim("equal rates about all axes do not do: rank must equal the number of columns",
              "rank condition", f"rank {_rank_of_equal()} of 4", HOLDS),
        Claim("sample 3: recovered with rates w, w^1/2, w^1/3", "n11, n22 = 1.0",
              f"{below(_off(s3))}, with omega_x = w (printed omega_y twice) and n11 = n22 = 0.1 "
              "(printed 0.01 and 1.0)", CORRECTED),
        Claim("sample 3 is a design to use", "no word on noise",
              f"condition number {plain_condition(s3):.0f}; 1 mV of noise leaves n13 uncertain by "
              f"{_percent(loss_3[0, 2])}, the worst by {_percent(loss_3.max())}", FAILS),
        Claim("sample 4: recovered with rates w, exp(-w), w^2", "rows 6 and 7 of the result",
              f"{below(_off(s4))}; printed rows 6 and 7 are swapped "
              f"({below(float(np.abs(PRINTED_4 - swapped).max()))} when put right)", CORRECTED),
        Claim("sample 4 is a design to use", "no word on noise",
              f"condition number {plain_condition(s4):.2g}; 1 mV of noise leaves n13 uncertain by "
              f"{_percent(loss_4[0, 2])}, the worst by {_percent(loss_4.max())}", FAILS),
        Claim("least squares and a Kalman filter", "least squares only",
              f"equal {below(alike)} of the usual size of the parameters, samples 1 to 4", HOLDS),
    ]  # fmt: skip


def _rank_of_equal() -> int:
    w = 10.0 * np.arange(11)
    return int(np.linalg.matrix_rank(np.c_[np.ones(11), w, w, w]))


def _refused() -> bool:
    w = np.repeat(10.0 * np.arange(11)[:, None], 3, axis=1)
    try:
        solved(gyros(w))
    except HandcalError:
        return True
    return False


def _error_claims() -> list[Claim]:
    rng = np.random.default_rng(0)
    table_alone = monte_carlo(1.5 * ARCSEC, 0.0, rng)
    tilt_alone = monte_carlo(0.0, 2.0 * ARCMIN, rng)
    off = max(float(np.abs(f / s - 1.0).max()) for s, f, _ in (table_alone, tilt_alone))
    _, _, without = tilt_alone
    ratio = without / tilt_alone[0]
    micro = 1e6 * table_alone[1][0]
    return [
        Claim("section V: errors of B, K follow from those of the matrix and of the readings",
              "formula", f"within {_percent(off)} of {RUNS} runs, if the correlations between the "
              "delta b are kept", CORRECTED),
        Claim("delta b as independent errors", "sum over i",
              f"off by factors from {ratio.min():.2f} to {ratio.max():.0f} for a tilt of the base, "
              "which all positions share", FAILS),
        Claim("standard deviation of a bias: root", "root over the 1/(m - 1) alone",
              "the root covers the sum", CORRECTED),
        Claim("turntable of 1.5 arcsec", "no figure",
              f"biases good to {micro.min():.2f} to {micro.max():.2f} µV", HOLDS),
        Claim("inclination of 2 arcmin", "mentioned beside the turntable",
              f"up to {1e6 * tilt_alone[1].max():.0f} µV: dominates, and more positions do not "
              "average it out", HOLDS),
    ]  # fmt: skip


def _percent(part: float) -> str:
    return f"{100.0 * part:.2g} %" if part < 1.0 else f"{100.0 * part:.0f} %"


def _rates_table(number: int, rates: Array) -> Shown:
    rows = tuple((f"{i + 1}", *(f"{v:.0f}".replace("-", "−") for v in row))
                 for i, row in enumerate(rates))  # fmt: skip
    columns = ("test", "x, deg/s", "y, deg/s", "z, deg/s")
    return Shown(f"Ten tests instead of those of sample {number}", columns, rows)
