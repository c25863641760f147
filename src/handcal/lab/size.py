"""Size effect (paper 003): where each of the three accelerometers sits.

Two ways to know what the accelerometers should read:

- spins: the device stands on a rate table and turns steadily about the vertical, in several
  attitudes. The gyro says which axis is up and how fast it turns, gravity is known, and what a
  spin reads beyond a rest in the same attitude is the centripetal force at each accelerometer.
- a reference: a second IMU on the same body (``/reference``) in any fast motion. The arms are
  then those from its accelerometers, each from the one with the same axis.

Everything is linear in the parameters of the catalogue, so one least squares serves both.
Spins about the body axes alone do not show the arms across an accelerometer's axis, however
exact the paper's equation 24 is; they are refused, and spins that do are proposed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import nnls

from handcal.design.poses import MOUNTING
from handcal.earth import STANDARD_GRAVITY
from handcal.effects import Effect, select
from handcal.estimate import regression
from handcal.estimate.regression import BIASES
from handcal.lab import steady_tests
from handcal.lab.known_input import known_input
from handcal.lab.sound import refuse_dead, refuse_incredible
from handcal.lab.spins import LEAST_SIGMA, SPINNING, of_spins
from handcal.lab.telling import refuse_unseen
from handcal.observations import Scene
from handcal.observations.known_input import matched, read_at
from handcal.recordings import segment
from handcal.signals import of_arrays
from handcal.types import Array, BoolArray, HandcalError, Parameter, Recording

STATIC: tuple[Effect, ...] = (BIASES[1], *select(("accel_scale", "accel_misalignment")), MOUNTING)
ARMS = select(("size_effect",))
EFFECTS = STATIC + ARMS
KNOWN_ARMS = ("accel_scale", "accel_misalignment", "size_effect")
# Of shaken readings: noise at rest m/s^2, and by turning rate m/s, to begin with.
SHAKEN = (0.1, 0.1)
ROUNDS = 6
BLOCK_S = 1.0
FEWEST_SHAKEN = 200
# Turns of which so much is steady are spins, whatever is lost in speeding up and down.
STEADY = 0.2
REST_HZ = 5.0
TELLING = 0.5
FACE_DIAGONALS = np.array(
    [[1, 1, 0], [1, -1, 0], [1, 0, 1], [1, 0, -1], [0, 1, 1], [0, 1, -1]]
) / np.sqrt(2.0)


@dataclass(frozen=True)
class Sized:
    """What the readings say of the accelerometers' places.

    way: "spins" or "reference"; parameters and covariance (k, k): bias, scale, misalignment and
    mounting of the accelerometers, and ``size_effect``. Of n readings: rate (n,) rad/s, of a
    shake that within half a second about each; before, after (n, 3): what is left without arms
    and with them, m/s^2.
    """

    recording: Recording | None
    way: str
    parameters: tuple[Parameter, ...]
    covariance: Array
    rate: Array
    before: Array
    after: Array
    warnings: tuple[str, ...]

    @property
    def arms(self) -> Array:
        """Row i: the place of accelerometer i (3, 3), m."""
        return np.array([self.parameters[i].value for i in self._where]).reshape(3, 3)

    @property
    def arm_sigma(self) -> Array:
        """Standard deviations (3, 3), m."""
        return np.array([self.parameters[i].sigma for i in self._where]).reshape(3, 3)

    @property
    def _where(self) -> list[int]:
        return [i for i, p in enumerate(self.parameters) if p.effect == ARMS[0].id]

    @property
    def lever(self) -> tuple[Array, Array]:
        """The mean of the three places (3,) and its standard deviations, m."""
        mean = np.kron(np.full((1, 3), 1.0 / 3.0), np.eye(3))
        P = self.covariance[np.ix_(self._where, self._where)]
        return self.arms.mean(axis=0), np.sqrt(np.diag(mean @ P @ mean.T))


def size(recording: Recording, gravity: float = STANDARD_GRAVITY) -> Sized:
    """The places of the accelerometers, from steady spins or from a shake beside a reference.

    Errors: HandcalError where the readings do not show them; the sentence says what would.
    """
    refuse_dead(recording)
    if "reference" not in recording.streams:
        return of_tests(of_spins(recording, gravity), recording)
    imu = recording.imu
    fast = np.linalg.norm(imu.gyro, axis=1) > SPINNING
    steady = _inside(imu.t, segment.steady(recording))
    if (fast & steady).sum() > STEADY * fast.sum():
        return of_tests(steady_tests.of_recording(recording), recording)
    return of_reference(recording)


# --- spins --------------------------------------------------------------------------------------


def of_tests(tests: steady_tests.Bench, recording: Recording | None = None) -> Sized:
    """From tests of known rate and force: rests and steady spins. Errors: HandcalError."""
    truth = tests.mean(np.hstack([tests.truth.gyro, tests.truth.accel]))
    rate = np.linalg.norm(truth[:, :3], axis=1)
    if not tests.used[3:].all() or not (rate > SPINNING).any():
        raise HandcalError(
            "Nothing was read of the accelerometers in a spin faster than 20 deg/s: only fast "
            "turns show where they sit."
        )
    _refuse_spins(tests, truth[rate > SPINNING, :3])
    plain, found = (known_input(tests, ids) for ids in (KNOWN_ARMS[:-1], KNOWN_ARMS))
    return Sized(
        recording, "spins", found.parameters, found.covariance, rate, plain.residual[:, 3:, 1],
        found.residual[:, 3:, 1], found.warnings,
    )  # fmt: skip


def _refuse_spins(tests: steady_tests.Bench, spun: Array) -> None:
    """Refused where arms or other parameters stay hidden at what readings are really worth."""
    unknowns = regression.unknowns(EFFECTS)
    usual = regression.priors(unknowns)
    A = steady_tests.design(tests, EFFECTS, np.zeros(len(usual)), tests.truth)[:, 3:]
    worth = np.maximum(np.sqrt(tests.variance[:, 3:]), LEAST_SIGMA)
    rows = (A / worth[:, :, None]).reshape(-1, len(usual))
    R = np.linalg.qr(np.vstack([rows * usual, np.eye(len(usual))]), mode="r")
    sigma = np.linalg.norm(np.linalg.solve(R, np.eye(len(usual))), axis=1) * usual
    lost = [u.param.name for u, s, p in zip(unknowns, sigma, usual, strict=True)
            if u.effect == ARMS[0].id and s > TELLING * p]  # fmt: skip
    if lost:
        raise HandcalError(
            f"Spins about {_named(spun)} do not show the arms {', '.join(lost)}: what they read "
            "changes by less than an accelerometer drifts. Spin about the six diagonals of the "
            f"faces instead, {_named(FACE_DIAGONALS)}, each after a rest in the same attitude."
        )
    refuse_unseen(rows, unknowns, noise=True, hint="Rest and spin in more attitudes.")


def _named(up: Array) -> str:
    """Directions as "x, x+y and x−z", each once, whichever of its ends is up."""
    names = []
    for u in up:
        v = u / np.abs(u).max()
        v = np.where(np.abs(v) < 0.2, 0.0, v)
        v = v * np.sign(v[np.flatnonzero(v)[0]])
        parts = [("+" if c > 0 else "−") + axis for c, axis in zip(v, "xyz", strict=True) if c]
        names.append("".join(parts).removeprefix("+"))
    unique = list(dict.fromkeys(names))
    return " and ".join([", ".join(unique[:-1]), unique[-1]]) if len(unique) > 1 else unique[0]


# --- a reference --------------------------------------------------------------------------------


def of_reference(recording: Recording) -> Sized:
    """From any fast motion beside a reference; see ``size``.

    The rate is taken as it is read: smoothed before it is squared, the arm would come out too
    long. Readings near saturated or missing ones are left out.
    """
    rests = segment.rests(recording)
    both = matched(recording, Scene(rests, False))
    if both is None:
        raise HandcalError("The reference has too few readings beside sound ones of the IMU.")
    truth = both.known(both.t)
    signals = of_arrays(both.t, np.ascontiguousarray(truth[:, :3]), truth[:, 3:])
    rate = np.linalg.norm(signals.gyro, axis=1)
    use = both.sound & (rate > SPINNING)
    if use.sum() < FEWEST_SHAKEN:
        raise HandcalError(
            "The device hardly turns in this recording: shake it with fast turns about all axes, "
            "to and fro, for a minute; the arms are felt in proportion to the square of the rate."
        )
    few = np.arange(len(both.t)) % max(1, round(recording.rate_hz / REST_HZ)) == 0
    use |= both.sound & few & _inside(both.t, rests)
    pace = np.sqrt(uniform_filter1d(rate**2, round(segment.WINDOW_S * recording.rate_hz)))
    unknowns = regression.unknowns(EFFECTS)
    A = regression.columns(EFFECTS, np.zeros(len(unknowns)), signals)[use, 3:]
    y = (read_at(recording, both.t) - truth)[use, 3:]
    sigma = np.hypot(SHAKEN[0], SHAKEN[1] * pace[use])[:, None] * np.ones(3)
    seen = np.asarray(np.linalg.qr(_weighted(A, sigma)).R)
    refuse_unseen(seen, unknowns, noise=True, hint="Turn it faster, and about all of its axes.")
    for _ in range(ROUNDS):
        sigma = _spread(y - A @ _fit(A, y, sigma).x, pace[use])
    fit = _fit(A, y, sigma)
    P = _clustered(A, y - A @ fit.x, sigma, both.t[use])
    plain = A[:, :, : len(regression.unknowns(STATIC))]
    parameters = regression.parameters(unknowns, fit.x, np.sqrt(np.diag(P)))
    refuse_incredible((p.effect, p.name, p.value) for p in parameters)
    return Sized(
        recording, "reference", parameters, P, pace[use], y - plain @ _fit(plain, y, sigma).x,
        y - A @ fit.x, (),
    )  # fmt: skip


def _weighted(A: Array, sigma: Array) -> Array:
    """Rows (3 n, k) of unit variance."""
    return np.asarray((A / sigma[:, :, None]).reshape(-1, A.shape[2]))


def _fit(A: Array, y: Array, sigma: Array) -> regression.Estimate:
    return regression.least_squares(_weighted(A, sigma), (y / sigma).ravel())


def _inside(t: Array, spans: Array) -> BoolArray:
    """Which times (n,) lie within spans (r, 2)."""
    out = np.zeros(len(t), dtype=np.bool_)
    for a, b in spans:
        out |= (t >= a) & (t <= b)
    return out


def _spread(left: Array, rate: Array) -> Array:
    """Standard deviations (n, 3) of what is left (n, 3): of each axis a part that is always
    there, and one in proportion to the rate (n,)."""
    out = np.empty_like(left)
    for i in range(3):
        square = left[:, i] ** 2
        sigma2 = np.full(len(rate), square.mean())
        for _ in range(ROUNDS):
            B = np.stack([np.ones(len(rate)), rate**2], axis=1) / sigma2[:, None]
            parts, _ = nnls(B, square / sigma2)
            sigma2 = np.maximum(parts[0] + parts[1] * rate**2, LEAST_SIGMA**2)
        out[:, i] = np.sqrt(sigma2)
    return out


def _clustered(A: Array, left: Array, sigma: Array, t: Array) -> Array:
    """Covariance (k, k) that takes errors as alike within a second (White's, by clusters): what
    sampling misses of a shake is not new at each sample."""
    rows = _weighted(A, sigma)
    P = regression.least_squares(rows, np.zeros(len(rows))).P
    pushed = rows * (left / sigma).reshape(-1, 1)
    block = np.repeat(np.floor((t - t[0]) / BLOCK_S).astype(int), 3)
    sums = np.zeros((block.max() + 1, rows.shape[1]))
    np.add.at(sums, block, pushed)
    used = len(np.unique(block))
    return np.asarray(used / (used - 1) * P @ (sums.T @ sums) @ P)


def force_of(omega_degs: float, arm: float) -> float:
    """What an arm, m, adds to a reading while turning at a rate, deg/s; m/s^2."""
    return float(np.radians(omega_degs) ** 2 * arm)
