"""Paper 003 (Zhang, Li, Qin, Shen, 2017), formula by formula, and its printed numbers.

An accelerometer i has a direction of its own, row i of C (the paper's ``C_a^b`` transposed),
a scale k_i and a bias B_i: ``u_i = k_i (B_i + c_i . (f + W r_i))``, with W r the force that
turning adds at the place r. Forces are in g here, as in the paper's tables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handcal.compiled import strapdown
from handcal.design.poses import HELD
from handcal.earth import STANDARD_GRAVITY
from handcal.estimate import regression
from handcal.lab.papers.paper import CORRECTED, FAILS, HOLDS, UNKNOWN, Claim, Paper, Progress
from handcal.lab.papers.table import Table
from handcal.lab.size import ARMS, FACE_DIAGONALS, force_of
from handcal.signals import of_arrays
from handcal.types import Array

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
# Table 2, likewise x up; before compensation y and z read this.
TABLE_2_BEFORE = np.array([1.00043, 0.01299, -0.00911])
# Table 4: readings after compensation with x up and x down, g, and what they should be.
TABLE_2 = np.array([1.00041, 0.00098, 0.00023])
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
    signals = of_arrays(np.arange(float(len(held))), held, np.zeros_like(held))
    J = regression.columns(ARMS, np.zeros(9), signals)[HELD // 2 :: HELD, 3:]
    return np.asarray(np.stack([J[:, i, 3 * i : 3 * i + 3] for i in range(3)], axis=1))


def outputs(s: Static, f: Array, omega: Array, places: Array) -> Array:
    """Outputs u (n, 3) under forces f (n, 3), g, while turning at omega (n, 3), rad/s."""
    pushed = np.einsum("ij,njk,ik->ni", s.C, swing(omega), places) / STANDARD_GRAVITY
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
    up = np.array([0.0, 0.0, STANDARD_GRAVITY])
    g_n, none = np.array([0.0, 0.0, -STANDARD_GRAVITY]), np.zeros(3)
    p, v, _ = strapdown.integrate(t, omega, error + up, none, none, np.eye(3), g_n, none)
    return Drift(float(np.linalg.norm(v, axis=1).max()), float(np.linalg.norm(p, axis=1).max()))


def pushed(t: Array, angle: Array, places: Array) -> Array:
    """What accelerometers at these places (3, 3), m, read too much (n, 3), m/s^2."""
    omega = np.zeros((len(t), 3))
    omega[:, 2] = np.gradient(angle, t, edge_order=2)
    return regression.errors(ARMS, places.ravel(), of_arrays(t, omega, np.zeros_like(omega)))[:, 3:]


def found_places(sigma: float, rate: float, rng: np.random.Generator) -> Array:
    """Places (3, 3), m, from six spins about the diagonals of the faces at a rate, rad/s, and
    rests before them, each reading with noise sigma, m/s^2; truth: tables 1 and 3."""
    C = cosines(ANGLES)
    device = Static(BIAS, SCALE, C)
    omega = rate * FACE_DIAGONALS
    read = [STANDARD_GRAVITY * device.sensed(outputs(device, FACE_DIAGONALS, w, PLACES))
            + sigma * rng.standard_normal(omega.shape) for w in (omega, 0.0 * omega)]  # fmt: skip
    return arms(C, read[0] - read[1], omega)[0]


# --- the claims, computed again -----------------------------------------------------------------

NOISE = 1e-4 * STANDARD_GRAVITY
BODY_DIAGONALS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3.0)
SECONDS, STEP = 100.0, 0.005
MM = 1000.0
ROUNDING = 1e-12


def paper(progress: Progress) -> Paper:
    """All of it, computed again."""
    claims = [*_static_claims(), *_arm_claims()]
    progress(0.3)
    claims += _drift_claims()
    progress(0.6)
    runs = _runs()
    progress(1.0)
    diagonal = {
        n: spread(up, 200.0) for n, up in (("six", FACE_DIAGONALS), ("four", BODY_DIAGONALS))
    }
    beyond = (
        ("arms across an accelerometer's axis, 0.1 mg, 200 deg/s",
         f"± {_range(spread(np.eye(3), 200.0))} mm (spins about x, y, z)",
         f"± {_range(diagonal['six'])} mm (six spins about face diagonals)"),
        ("the same with the spins that `handcal design poses --known spin` finds", "",
         f"± {_range(diagonal['four'])} mm (four spins about the cube's diagonals)"),
        ("spins that cannot show an arm", "\"make an angle deviate\"",
         "refused, the spins that can are named"),
        ("without a rate table", "", "from a shake beside a second IMU (`handcal lab size`)"),
        ("a table whose axis leans", "", "found from the spins; their means do not feel it"),
    )  # fmt: skip
    source = (
        "Zhang, Li, Qin, Shen: Comprehensive Calibration of Strap-Down Tri-Axis Accelerometer "
        "Unit, Sensors 17(3), 2017"
    )
    return Paper("003", source, tuple(claims), beyond, (runs,))


def spins(rate: float, noise: Array | None = None) -> tuple[Array, Array, Array]:
    """C, and what is sensed in spins about x, y and z with that axis up, and at rest, (3, 3)
    each, m/s^2; rate rad/s; noise (2, 3, 3) m/s^2 of both."""
    C = cosines(ANGLES)
    device = Static(BIAS, SCALE, C)
    read = (outputs(device, np.eye(3), w * np.eye(3), PLACES) for w in (rate, 0.0))
    spin, rest = (STANDARD_GRAVITY * device.sensed(x) for x in read)
    return (C, spin, rest) if noise is None else (C, spin + noise[0], rest + noise[1])


def spread(up: Array, degs: float) -> Array:
    """Standard deviations (3, 3), m, of places from spins about up (n, 3) at a rate, deg/s, each
    less a rest, with readings good to 0.1 mg; C of table 1."""
    sigma = arms(cosines(ANGLES), np.zeros_like(up), np.radians(degs) * up)[1]
    return np.asarray(np.sqrt(2.0) * NOISE * sigma)


def _range(sigma: Array) -> str:
    off = MM * sigma[~np.eye(3, dtype=bool)]
    low, high = f"{off.min():.2g}", f"{off.max():.2g}"
    return low if low == high else f"{low} to {high}"


def _below(x: float) -> str:
    """What is but rounding is not the same on every machine."""
    return f"{ROUNDING:.0e}" if x < ROUNDING else f"{x:.0e}"


def _static_claims() -> list[Claim]:
    C = cosines(ANGLES)
    device = Static(BIAS, SCALE, C)
    faces = np.vstack([np.eye(3), -np.eye(3)])
    u = outputs(device, faces, 0.0 * faces, PLACES)
    found = static(u, faces)
    off = max(float(np.abs(a - b).max()) for a, b in
              ((found.bias, BIAS), (found.scale, SCALE), (found.C, C)))  # fmt: skip
    wrong = 1000.0 * float(np.abs(device.transposed(u) - faces).max())
    assert np.abs(device.force(u) - faces).max() < ROUNDING
    table_2 = 1000.0 * np.abs(TABLE_2 - [1.0, 0.0, 0.0]).max()
    table_4 = 1000.0 * np.abs(TABLE_4 - np.array([[1.0, 0, 0], [-1.0, 0, 0]])).max()
    return [
        Claim("15 parameters: 3 biases, 3 scale factors, 9 angles", "15",
              f"12 are free: the squares of an axis' three cosines add up to one. Six positions "
              f"give them back to {_below(off)}. The nine arms come on top", CORRECTED),
        Claim("table 1: angle of accelerometer y to y", f"{ANGLES[1, 1]:.3f} deg",
              f"{found.angles[1, 1]:.3f} deg, from the two others", CORRECTED),
        Claim("C is orthogonal, its inverse is its transpose (equation 4)", "assumed",
              f"C C' differs from 1 by {np.abs(C @ C.T - np.eye(3)).max():.1e}: the transpose "
              f"leaves {wrong:.1f} mg, the inverse none", FAILS),
        Claim("less than 1 mg after static compensation (table 2)", "< 1 mg",
              f"{table_2:.2f} mg at most in the table", HOLDS),
        Claim("less than 1 mg after dynamic compensation (table 4)", "< 1 mg",
              f"{table_4:.1f} mg in the table itself", FAILS),
    ]  # fmt: skip


def _arm_claims() -> list[Claim]:
    rate = np.radians(100.0)
    C, spin, rest = spins(rate)
    mended = np.abs(equation_24(C, spin, rest, rate) - PLACES).max()
    printed = np.abs(equation_24_printed(C, spin, rest, rate) - PLACES[:, 0]).max()
    C, spin, rest = spins(rate, NOISE * np.random.default_rng(0).standard_normal((2, 3, 3)))
    by_squares, _ = arms(C, spin - rest, rate * np.eye(3))
    apart = np.abs(equation_24(C, spin, rest, rate) - by_squares).max()
    own = MM * np.diag(spread(np.eye(3), 100.0))
    return [
        Claim("equation 24 gives the places", "formula",
              f"with f_i0 for the second f_i of each line: to {_below(mended)} m without noise; as "
              f"printed wrong by up to {printed:.1f} m", CORRECTED),
        Claim("is equation 24 as good as least squares?", "",
              f"it is least squares: equal to {_below(apart)} m on noisy readings", HOLDS),
        Claim("nine arms from spins about x, y and z at 100 deg/s (table 3: to 0.01 mm)",
              "-0.26 to -2.56 mm off the axes",
              f"at 0.1 mg those off the axes are good to {_range(spread(np.eye(3), 100.0))} mm, "
              f"those along them to {own.max():.2g} mm: six of the nine are noise", FAILS),
    ]  # fmt: skip


def _drift_claims() -> list[Claim]:
    t = np.arange(0.0, SECONDS + 0.5 * STEP, STEP)
    rate = np.radians(100.0)
    arm = np.diag([0.01, 0.0, 0.0])
    turning = reckoned(t, rate * t, pushed(t, rate * t, arm))
    force = TABLE_2_BEFORE[1] * STANDARD_GRAVITY
    until = t <= 4.0 / force
    before, after = (
        reckoned(t[until], 0.0 * t[until], np.tile([f, 0.0, 0.0], (int(until.sum()), 1)))
        for f in (force, TABLE_2[1] * STANDARD_GRAVITY)
    )
    return [
        Claim("10 mm at 100 deg/s read too much by", "0.03 m/s²",
              f"{force_of(100.0, 0.01):.4f} m/s²", HOLDS),
        Claim("after 100 s that is an error of", "3 m/s, 150 m",
              f"at most {turning.speed:.3f} m/s and {turning.distance:.1f} m: the error turns with "
              "the body", FAILS),
        Claim("static errors: before compensation (figure 6)", "4 m/s, 100 m",
              f"13 mg make {before.speed:.1f} m/s in {t[until][-1]:.0f} s, and "
              f"{before.distance:.0f} m", CORRECTED),
        Claim("after compensation (figure 7)", "0.02 m/s, 0.3 m",
              f"the {1000.0 * TABLE_2[1]:.2f} mg left in table 2 would make {after.speed:.2f} m/s "
              f"and {after.distance:.1f} m in that time", UNKNOWN),
    ]  # fmt: skip


def _three(x: float) -> str:
    return f"{x:.0f}" if x >= 100.0 else f"{x:.3g}"


def _runs() -> Table:
    """Dead reckoning for 100 s with the arms of table 3, before and after their calibration."""
    t = np.arange(0.0, SECONDS + 0.5 * STEP, STEP)
    found = found_places(NOISE, np.radians(200.0), np.random.default_rng(0))
    swinging = np.radians(30.0) * np.sin(4.0 * np.pi * t)
    rows = []
    for name, angle in (
        ("spinning at 100 deg/s", np.radians(100.0) * t),
        ("spinning at 200 deg/s", np.radians(200.0) * t),
        ("to and fro by 30 deg, twice a second", swinging),
    ):
        before, after = (reckoned(t, angle, pushed(t, angle, p)) for p in (PLACES, PLACES - found))
        rows.append((name, f"{before.speed:.3g}", _three(before.distance), f"{after.speed:.2g}",
                     f"{after.distance:.2g}"))  # fmt: skip
    return Table(
        "Dead reckoning for 100 s, table 3's places, before and after",
        ("motion", "before, m/s", "before, m", "after, m/s", "after, m"), tuple(rows),
        note="About the vertical, attitude known exactly; places from six spins about the face "
        "diagonals at 200 deg/s, readings good to 0.1 mg. A spin carries the error around; turned "
        "to and fro it adds up, because the three accelerometers sit in different places.",
    )  # fmt: skip
