"""What the filter is told from outside: one file a pseudo-observation or reference.

A file defines ``OBSERVATION = Observation(...)``; the folder listing is the catalogue.
The heart of each is a compiled ``residual(nav, theta, z, r) -> status`` that writes
observed minus predicted into ``r`` and returns 0, or 1 to leave this one out. ``nav``
is flat: position 0-2, velocity 3-5, C_nb row by row 6-14, true rate 15-17 and true
specific force 18-20 in b; ``theta`` are the observation's own unknowns.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from handcal.compiled.kernel import NAV as NAV
from handcal.earth import STANDARD_GRAVITY
from handcal.types import Array, IntArray, Level, Markov, Recording, Series


@dataclass(frozen=True)
class Scene:
    """What an observation may look at to make its rows.

    rests (r, 2) s; has_heading: an absolute heading is observed, so n's yaw is fixed by
    it; align_yaw: yaw of n against that of the pose's world at the start, rad;
    rate (Hz): of pseudo-observations, None for every IMU sample; sway: the hand's
    motion is modelled as a Markov process instead of white noise. omega_ie_n (3,): the
    Earth's rate, rad/s; gravity: its size, m/s^2. reference_exact: a reference has no bias.
    iron (3,): a magnetometer's hard iron as far as it is known beforehand, tesla (None: what the
    readings lie around). origin: the recording is a piece of one that began at this time, s, from
    where pseudo-observations are counted.
    """

    rests: Array
    has_heading: bool
    align_yaw: float | None = None
    rate: float | None = 10.0
    sway: bool = True
    omega_ie_n: Array = field(default_factory=lambda: np.zeros(3))
    gravity: float = STANDARD_GRAVITY
    reference_exact: bool = False
    iron: Array | None = None
    origin: float | None = None


@dataclass(frozen=True)
class Rows:
    """Observations of one kind: t (k,) s on the IMU's clock, z (k, zdim): numbers before
    ``effects.DELAY``, and from ``effects.Z_DIM`` on if there are more.

    delay: s by which they are known to come late; they are put where they belong. alpha: angular
    acceleration (n, 3) at the IMU's samples, rad/s^2, if these observations know it. moved (k,):
    by how much the place that they hold may be another than at the row before, m.
    """

    t: Array
    z: Array
    delay: float = 0.0
    alpha: Array | None = None
    moved: Array | None = None


@dataclass(frozen=True)
class Constant:
    """An unknown constant of an observation, with mean zero and a prior."""

    name: str
    unit: str
    prior_sigma: float


@dataclass(frozen=True)
class Observation:
    """One kind of observation.

    dim, channels, unit describe the residual; ``residual`` and ``jacobian`` are addresses
    of compiled functions (jacobian 0: central difference), the latter writing (dim, 15)
    by position, velocity, psi, rate and force. ``variance(levels)`` -> (dim,).
    markov_residual: corrects the residual for the Markov states, which are its theta.
    isotropic: where z is zero, the residual is a vector in n without preferred direction.
    wandering: first of each three Markov states that are a velocity of a point that wanders at
    random: what it feels is no motion that could excite an effect.
    folds: one number, read so often that its readings within a tenth of a second may be folded into
    one, or those between two looks at a held point gathered into a few.
    navigates: it says something of position, velocity or attitude. places: it says where the
    device is.
    believed(z (k, zdim), theta): z with what effects have to know of the observation's constants,
    at which everything is linearised.
    ours(z (k, zdim), read (k, 6)): share (dim,) of the variance of its white noise that is the
    IMU's, for an observation of the readings themselves.
    guess(z (k, zdim)): first guesses of levels that the observations themselves show.
    moved(recording, series, C_nb (m, 3, 3), shift (m, dim)): the stream as it would read if its
    residuals were larger by the shift.
    """

    kind: str
    title: str
    dim: int
    channels: tuple[str, ...]
    unit: str
    residual: int
    rows: Callable[[Recording, Scene], Rows | None]
    levels: tuple[Level, ...]
    variance: Callable[[Mapping[str, float]], Array]
    jacobian: int = 0
    constants: Callable[[Scene], tuple[Constant, ...]] = lambda _: ()
    markov: Markov | None = None
    markov_residual: int = 0
    guess: Callable[[Array], Mapping[str, float]] | None = None
    believed: Callable[[Array, Array], Array] | None = None
    ours: Callable[[Array, Array], Array] | None = None
    moved: Callable[[Recording, Series, Array, Array], Series] | None = None
    isotropic: bool = False
    wandering: tuple[int, ...] = ()
    navigates: bool = True
    places: bool = False
    folds: bool = False


@cache
def catalogue() -> Mapping[str, Observation]:
    """Every observation in this folder, by kind; files with an underscore serve several."""
    found: dict[str, Observation] = {}
    for info in pkgutil.iter_modules(__path__):
        if info.name.startswith("_"):
            continue
        observation: Observation = importlib.import_module(f"{__name__}.{info.name}").OBSERVATION
        found[observation.kind] = observation
    return found


def nearest(t: Array, wanted: Array) -> IntArray:
    """Number of that of the times t (n,) which is nearest to each of the times wanted (m,)."""
    right = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    return np.where(wanted - t[right - 1] < t[right] - wanted, right - 1, right)


def pseudo_times(
    recording: Recording, rate: float | None, rests: Array | None = None,
    origin: float | None = None,
) -> Array:  # fmt: skip
    """Stamps of IMU samples, one in every 1/rate seconds (all of them for None).

    The place within each slot is scattered (a Weyl sequence, so always the same): a hand
    trembles at 8 to 12 Hz, which regular times would alias into a correlated error.
    rests (r, 2): only within these. origin: of a piece that goes on, where slots are counted
    from, s; what is to come is left to the next piece.
    """
    t = recording.imu.t
    if rate is not None and rate < recording.rate_hz:
        begin = t[0] if origin is None else origin
        slot = np.arange(max(0, int((t[0] - begin) * rate)), int((t[-1] - begin) * rate) + 1)
        wanted = begin + (slot + (slot * slot * 0.6180339887498949) % 1.0) / rate
        if origin is not None:
            wanted = wanted[(wanted > t[0]) & (wanted <= t[-1])]
        t = t[np.unique(np.clip(np.searchsorted(t, wanted), 0, len(t) - 1))]
    if rests is not None:
        inside = np.zeros(len(t), dtype=bool)
        for a, b in rests:
            inside |= (t >= a) & (t <= b)
        t = t[inside]
    return np.asarray(t, dtype=np.float64)
