"""Frozen dataclasses that travel between the modules. Nothing here computes.

Shapes are written as (n, 3); units are SI unless a name says otherwise
(the conventions are in ``handcal/__init__.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

# How large constant biases of consumer-grade sensors are, rad/s and m/s^2.
GYRO_BIAS_PRIOR = float(np.radians(1.0))
ACCEL_BIAS_PRIOR = 0.6


class HandcalError(Exception):
    """A sentence for the user: why there is no result. Exit status 1."""


class InputError(HandcalError, ValueError):
    """A sentence for the user: what is wrong with a file or an option. Exit status 2. In Python it
    is a ValueError too."""


# Letters of a value that a repr shows.
LONGEST_REPR = 100


class Brief:
    """A repr that fits on a screen: of an array its shape, of a long tuple how many it holds."""

    def __repr__(self) -> str:
        names = [f.name for f in fields(self)]  # type: ignore[arg-type]
        values = ", ".join(f"{name}={_brief(getattr(self, name))}" for name in names)
        return f"{type(self).__name__}({values})"


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"array{value.shape}"
    if isinstance(value, tuple | list | Mapping):
        if not value:
            return repr(value)
        keys = f": {', '.join(map(str, value))}" if isinstance(value, Mapping) else ""
        return f"<{len(value)} {type(value).__name__} items{keys}>"
    text = repr(value)
    return text if len(text) < LONGEST_REPR else f"<{type(value).__name__}>"


# What documents of this program call themselves.
CALIBRATION_SCHEMA = "handcal/calibration/1"
EXPLANATION_SCHEMA = "handcal/explanation/1"


@dataclass(frozen=True, repr=False)
class Imu(Brief):
    """Inertial readings on one time base, the gyro's.

    t: (n,) s since the start of the recording, strictly increasing.
    gyro: (n, 3) rad/s; accel: (n, 3) m/s^2, specific force. Both finite.
    valid: (n,) False where a reading is known not to be a measurement
        (saturated, masked out); the filter trusts it only within +-full scale.
    """

    t: Array
    gyro: Array
    accel: Array
    valid: BoolArray


@dataclass(frozen=True, repr=False)
class Series(Brief):
    """One further stream. t: (m,) s on the IMU's clock, increasing; value: (m, d).

    What d columns mean, and in which units, says the stream's row in ``streams``.
    """

    t: Array
    value: Array

    def thinned(self, rate: float) -> Series:
        """Of two readings or more every so many that about ``rate`` are left in a second, Hz; all
        where there are fewer."""
        step = max(1, round((len(self.t) - 1) / (self.t[-1] - self.t[0]) / rate))
        return Series(self.t[::step], self.value[::step])


@dataclass(frozen=True, repr=False)
class Recording(Brief):
    """What was recorded, in SI and in handcal's conventions.

    path: where it came from. streams: by name (rows of ``streams.STREAMS``),
    only those present. start_ns: absolute time of t = 0, ns since 1970 (0 if unknown).
    warnings: what the reader repaired, in sentences. topics: of a bag or an autopilot's log, by
    stream, where it was read. device, model: what the file itself says of the device, "" where it
    says nothing. vehicle: of an autopilot's log, parameters of the vehicle's own calibration by
    name (CAL_*, SENS_BOARD_*, TC_*; INS_*, AHRS_ORIENTATION), and ids of the sensors as
    ``topic.field``. corrected: of readings from which ``handcal apply`` took errors off, the names
    of the results by the sha256 of each. bias_temperature: degC,
    at which temperature errors are zero; a fit takes the recording's mean, so that biases are
    those at that temperature. sensors: those of the IMU that were recorded, both but where one was
    asked for alone; the readings of the other are zero. file_units: units and signs in the file,
    in half a sentence, where its format has several. rows: of each stream, and of gyro and accel
    where they are stamped by themselves, which of the file's readings each is, in the order of the
    file. unfit: why a calibration with these readings
    makes no sense, "" where nothing speaks against one.
    """

    path: str
    imu: Imu
    streams: Mapping[str, Series] = field(default_factory=dict)
    start_ns: int = 0
    warnings: tuple[str, ...] = ()
    topics: Mapping[str, str] = field(default_factory=dict)
    device: str = ""
    model: str = ""
    vehicle: Mapping[str, float] = field(default_factory=dict)
    corrected: Mapping[str, str] = field(default_factory=dict)
    bias_temperature: float = 25.0
    sensors: tuple[str, ...] = ("gyro", "accel")
    file_units: str = ""
    unfit: str = ""
    rows: Mapping[str, IntArray] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        return float(self.imu.t[-1] - self.imu.t[0])

    @property
    def rate_hz(self) -> float:
        """Median sampling rate of the IMU."""
        return float(1.0 / np.median(np.diff(self.imu.t)))


@dataclass(frozen=True)
class Parameter:
    """One estimated number and how far it can be trusted."""

    effect: str
    name: str
    value: float
    sigma: float
    unit: str
    prior_sigma: float
    converged_at_s: float | None

    @property
    def shown(self) -> bool:
        """Contract: sigma below half of its prior's, or the value beyond three sigmas from zero."""
        return self.sigma < 0.5 * self.prior_sigma or abs(self.value) > 3.0 * self.sigma


@dataclass(frozen=True, repr=False)
class Prior(Brief):
    """What is known of a device before a recording, SI.

    names (k,): (effect, parameter); mean (k,), covariance (k, k). What is not named is as
    uncertain as is usual. source: where it is from, as JSON says it.
    """

    names: tuple[tuple[str, str], ...]
    mean: Array
    covariance: Array
    source: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, repr=False)
class Likelihood(Brief):
    """What a recording itself says of its biases and of a device, without any prior, SI.

    names (k,): (effect, parameter). Log-likelihood vector' x - x' information x / 2 of the
    parameters x (k,), all else integrated out; information (k, k), vector (k,).
    """

    names: tuple[tuple[str, str], ...]
    information: Array
    vector: Array


@dataclass(frozen=True)
class NoiseLevel:
    """One noise level that the recording was found to have."""

    name: str
    value: float
    unit: str
    estimated: bool


@dataclass(frozen=True)
class Level:
    """A noise level: name, unit, first guess and the range in which it is estimated.

    below, above: how far it may stray from the first guess to either side, as a standard
    deviation of its logarithm. most: so many times the first guess it may be, and no more.
    shared: another level of the same process: root mean squares add up to what is seen, so that
    either may hold it all, this one in proportion to the turning rate.
    """

    name: str
    unit: str
    initial: float
    lower: float
    upper: float
    below: float = 2.0
    above: float = 2.0
    most: float = math.inf
    shared: str = field(default="", kw_only=True)


class Markov(Protocol):
    """Extra states with dynamics of their own (hand sway, correlated noise).

    vectors: how many of them, three by three from the first, are vectors in n. One with matrices of
    which most is zero may have a method ``weighed`` besides, which does what
    ``noise_levels.weighed`` does without them.
    """

    size: int
    vectors: int

    def transition(
        self, levels: Mapping[str, float], dt: Array, rate: Array
    ) -> tuple[Array, Array]:
        """Phi and Q, each (n, size, size), of steps dt (n,) s while turning at rate (n,) rad/s."""
        ...

    def start(self, levels: Mapping[str, float], rate: float) -> Array:
        """Covariance (size, size) at the start."""
        ...


@dataclass(frozen=True, repr=False)
class History(Brief):
    """The filter's solution over time, k rows.

    t (k,) s; p_n (k, 3) m; v_n (k, 3) m/s; q_nb (k, 4) quaternion w x y z of C_nb;
    yaw (k,) rad; nav_sigma (k, 9): of position, velocity, attitude error (rotation
    vector in n); parameters (k, m) and parameter_sigma (k, m), columns as in
    Result.parameters.
    """

    t: Array
    p_n: Array
    v_n: Array
    q_nb: Array
    yaw: Array
    nav_sigma: Array
    parameters: Array
    parameter_sigma: Array


@dataclass(frozen=True, repr=False)
class Innovations(Brief):
    """What one kind of observation said against the prediction, k updates of dimension d.

    t (k,) s; residual (k, d) observed minus predicted; sigma (k, d): square root of
    the diagonal of S; nis (k,): residual' S^-1 residual; skipped: updates left out
    (a heading while body x is near the vertical); unit of the residual.
    """

    t: Array
    residual: Array
    sigma: Array
    nis: Array
    skipped: int
    unit: str
    channels: tuple[str, ...]

    @property
    def mean_nis(self) -> float | None:
        """NIS per degree of freedom, 1 for a consistent filter."""
        if self.nis.size == 0:
            return None
        return float(self.nis.mean() / self.residual.shape[1])


@dataclass(frozen=True, repr=False)
class Standing(Brief):
    """Where a filter stands at one moment: its whole state, from which it can go on.

    t: s; p, v (3,), C (3, 3) of C_nb, bg, ba (3,); effects, kinds: ids of those in its model;
    names (c,): owner and name of each constant; processes: owner and number of states of each
    Markov process behind them; extras (c + e,): constants and Markov states; P (15 + c + e,
    15 + c + e): covariance of all of it; bias_temperature: degC, at which biases are these.
    """

    t: float
    p: Array
    v: Array
    C: Array
    bg: Array
    ba: Array
    effects: tuple[str, ...]
    kinds: tuple[str, ...]
    names: tuple[tuple[str, str], ...]
    processes: tuple[tuple[str, int], ...]
    extras: Array
    P: Array
    bias_temperature: float = 25.0


@dataclass(frozen=True, repr=False)
class MarkerRotation(Brief):
    """How the marker of a pose is turned on the device.

    quaternion (4,): w x y z of the matrix that takes vectors in the IMU's axes to the marker's;
    sigma (3,): rad, about the IMU's axes.
    """

    quaternion: Array
    sigma: Array


@dataclass(frozen=True, repr=False)
class Result(Brief):
    """What ``calibrate`` learnt from one recording.

    covariance: (m, m) of the parameters, rows as in ``parameters``. assume:
    "fixed-point" or "rest-only". innovations: by observation kind. observed: the
    heading or magnetometer headings the filter was given, (k, 2) of t and rad, or
    None. rests: (r, 2) start and end of each detected rest, s. smoothed: the same as
    ``history``, each row given the whole recording. settled: relinearising had come to rest.
    model: what was fitted, as JSON holds it (contract); repeated: it was read from a result.
    before: what was known of the device. standing: where the estimate stands at the last epoch.
    likelihood: of the recording alone. marker: None without a pose. doubts: why its numbers deserve
    less trust, as far as only the fit tells that.
    """

    recording: Recording
    assume: str
    parameters: tuple[Parameter, ...]
    covariance: Array
    noise: tuple[NoiseLevel, ...]
    history: History
    innovations: Mapping[str, Innovations]
    log_evidence: float
    rests: Array
    warnings: tuple[str, ...]
    observed_heading: Array | None = None
    smoothed: History | None = None
    settled: bool = True
    model: Mapping[str, Any] = field(default_factory=dict)
    repeated: bool = False
    before: Prior | None = None
    standing: Standing | None = None
    likelihood: Likelihood | None = None
    marker: MarkerRotation | None = None
    doubts: tuple[str, ...] = ()

    @property
    def observations(self) -> int:
        """Number of scalar observations used."""
        return int(sum(i.residual.size for i in self.innovations.values()))

    def parameter(self, effect: str, name: str) -> Parameter:
        """The parameter of that effect and name; KeyError if it was not estimated."""
        for p in self.parameters:
            if p.effect == effect and p.name == name:
                return p
        raise KeyError(f"{effect}.{name}")
