"""The catalogue of physics: one file an effect, and the folder listing is the catalogue.

A file defines ``EFFECT = Effect(...)`` and nothing else needs to know of it. Physics
enters in one of two ways:

- ``imu_error(parameters, signals) -> (n, 6)``: what the gyro (columns 0-2, rad/s) and
  the accelerometer (columns 3-5, m/s^2) read in addition, over a whole recording;
- ``observation_error``: for each kind of observation a compiled
  ``f(nav, parameters, z, r) -> 0`` that corrects the residual ``r`` in place. The last
  number of ``z`` (``z[TIME]``) is the time since the recording's start, s.

An effect that is noise brings a ``process`` instead: Markov states that walk with a bias
(``walks``) or that its ``observation_error`` takes for its parameters.

What an effect adds depends on the truth, of which only readings are known. Errors much
smaller than the signal are found by substitution; an effect that moves the signal as a
whole (a delay) brings ``imu_inverse(parameters, readings) -> (n, 6)``, the truth.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Protocol

import numpy as np

from handcal._jit import call_residuals
from handcal.types import Array, BoolArray, InputError, Level, Markov, Recording, Result

# What an effect may need besides streams.
ATTITUDE, PLACE = "attitude", "place"
# Places in an observation's z (Z_DIM numbers) that are the same for every kind.
Z_DIM = 46
DELAY, TIME = 44, 45


@dataclass(frozen=True)
class Param:
    """One parameter of an effect: its name, SI unit and prior standard deviation.

    positive: it cannot be negative (a time constant, a noise level). most: the largest size that
    makes sense.
    """

    name: str
    unit: str
    prior_sigma: float
    positive: bool = False
    most: float = math.inf


@dataclass(frozen=True)
class Signals:
    """What an effect may depend on, n samples: the best estimate of the truth so far.

    t (n,) s; gyro (n, 3) true rate, rad/s; accel (n, 3) true specific force, m/s^2; C_nb
    (n, 3, 3) attitude, or None before there is any; alpha (n, 3) angular acceleration, rad/s^2,
    or None where it is told by the rate alone. streams: what else was measured, (n, d) by the
    stream's name, with the columns and units of its row in ``handcal.streams``: all that no
    observation looks at, and what the effects need; only what the recording has, so an effect
    adds nothing where ``streams.get`` finds nothing. Made in ``handcal.signals``.
    """

    t: Array
    gyro: Array
    accel: Array
    C_nb: Array | None = field(default=None, kw_only=True)
    alpha: Array | None = field(default=None, kw_only=True)
    streams: Mapping[str, Array] = field(default_factory=dict, kw_only=True)

    @property
    def temperature(self) -> Array | None:
        """(n,) degC, None where the recording has none."""
        found = self.streams.get("temperature")
        return None if found is None else found[:, 0]


class Known(Protocol):
    """What is known of the truth in a recording into which an effect is put.

    recording: as it was; signals: rate and force as far as known; unbiased: less the biases that
    a calibration finds, where they must not count as motion.
    """

    @property
    def recording(self) -> Recording: ...

    @property
    def signals(self) -> Signals: ...

    @property
    def unbiased(self) -> Signals: ...

    def result(self, beside: tuple[str, ...] = ()) -> Result:
        """The recording's calibration, with these effects."""
        ...

    def attitude(self, t: Array, beside: tuple[str, ...] = ()) -> Array:
        """C_nb (m, 3, 3) at times t (m,)."""
        ...


@dataclass(frozen=True)
class Effect:
    """One cause of sensor error: its parameters, its physics and its story in plain words.

    needs: streams without which it cannot be told ("temperature"), ATTITUDE where ``imu_error``
    reads ``Signals.C_nb``, PLACE where it reads the position in ``nav``, which only some kinds of
    observation tell. delays: kinds of observation whose time its first
    parameter shifts, so that large ones can be found about a shifted time: ``z[DELAY]`` is
    the part already taken off. process: Markov states of noise, whose levels ``levels``
    have the parameters' names behind the id (``gyro_bias_walk_density``); walks: the reading
    they add to, "gyro" or "accel". moments: reference points (k, p) to be tried, given the
    recording's times, where the error is not linear in all parameters (a step at an unknown
    moment); held: of an effect held at one, the parameters of its ``observation_error``, nan where
    they are free. outliers: for each kind of observation the probability density of a reading that
    is merely wrong, in a share of readings that is the first parameter. exclusive: ids of
    effects of which this one keeps only what they lack: together with one of them, its
    parameters are those of ``together @ parameters``; always so where there is a gauge but no such
    effect. last: with ``imu_inverse``, whether it is
    done to what the other effects made of the truth (a filter behind a scale error), or to the
    truth alone, beside them. akin: ids of effects that are the same to the first order.
    made: of a law or a course found in a recording, its kind and its numbers.
    columns: of an effect that is linear in its parameters, what a unit of each adds, (n, 6, k).
    imitated: nats that a hand which turns the device about no single point can lend to this one,
    where only that point's rest tells where the device was.

    ``conceal`` and ``apply`` add and take off what all this says, the delays by shifting stamps.
    Where that is but an approximation, an effect brings its own ways: conceal(parameters,
    recording, known), the recording as a device with the effect makes it, and undo(parameters,
    recording), its reverse. world: it changes what there is to be measured, and is no error of a
    sensor. believed: for each kind of observation z (k, Z_DIM) with what others that act on it have
    to know of this one's parameters (k,), at which everything is linearised. of_one_day: another
    day it is another. sound(parameters, t (n,), valid (n,)): which
    readings depend on measurements alone, where what is read depends on other moments. instead:
    the effect that is the same on a stream on which this one does not act. baseline: it is in every
    model (a state of the filter), so it is never on trial. always: it is in every model of a
    recording in which one of its observations is used, whether asked for or not: nobody has none.
    tails: its prior has the wide scales that others have.
    """

    id: str
    title: str
    parameters: tuple[Param, ...]
    story: str
    source: str
    motion: str
    validated: str
    imu_error: Callable[[Array, Signals], Array] | None = None
    observation_error: Mapping[str, int] = field(default_factory=dict)
    imu_inverse: Callable[[Array, Signals], Array] | None = None
    needs: tuple[str, ...] = ()
    delays: tuple[str, ...] = ()
    process: Markov | None = None
    levels: tuple[Level, ...] = ()
    walks: str = ""
    moments: Callable[[Array], Array] | None = None
    held: tuple[float, ...] = ()
    outliers: Mapping[str, float] = field(default_factory=dict)
    exclusive: tuple[str, ...] = ()
    together: Array | None = None
    last: bool = True
    akin: tuple[str, ...] = ()
    imitated: float = 0.0
    made: tuple[str, tuple[float, ...]] | None = None
    columns: Callable[[Signals], Array] | None = None
    conceal: Callable[[Array, Recording, Known], Recording] | None = None
    undo: Callable[[Array, Recording], Recording] | None = None
    world: bool = False
    believed: Mapping[str, Callable[[Array, Array], Array]] = field(default_factory=dict)
    of_one_day: bool = False
    sound: Callable[[Array, Array, BoolArray], BoolArray] | None = None
    instead: str = ""
    baseline: bool = False
    always: bool = False
    tails: bool = True

    @property
    def prior_sigma(self) -> Array:
        """Prior standard deviations (k,) in the order of the parameters."""
        return np.array([p.prior_sigma for p in self.parameters])


def imu_jacobian(effect: Effect, at: Array, signals: Signals) -> Array:
    """Derivative (n, 6, k) of an effect's IMU error by its parameters, at ``at`` (k,).

    A central difference with steps of a thousandth of the prior: exact for effects
    linear in their parameters, as most are.
    """
    if effect.columns is not None:
        return effect.columns(signals)
    n, k = len(signals.t), len(effect.parameters)
    out = np.zeros((n, 6, k))
    if effect.imu_error is None:
        return out
    for i, step in enumerate(1e-3 * effect.prior_sigma):
        e = np.zeros(k)
        e[i] = step
        out[:, :, i] = (effect.imu_error(at + e, signals) - effect.imu_error(at - e, signals)) / (
            2 * step
        )
    return out


def correction_jacobian(effect: Effect, at: Array, truth: Signals) -> Array:
    """Derivative (n, 6, k) of what is taken off the readings by an effect's parameters.

    To first order in the error that of the error itself. For an effect that moves the signal as a
    whole it is not: what a later moment's reading says of this one changes as the truth of this
    moment does, not as the reading of the later one.
    """
    if effect.imu_inverse is None:
        return imu_jacobian(effect, at, truth)
    assert effect.imu_error is not None
    error = effect.imu_error(at, truth)
    read = replace(truth, gyro=truth.gyro + error[:, :3], accel=truth.accel + error[:, 3:])
    out = np.zeros((len(truth.t), 6, len(at)))
    for i, step in enumerate(1e-3 * effect.prior_sigma):
        e = np.zeros(len(at))
        e[i] = step
        less, more = effect.imu_inverse(at - e, read), effect.imu_inverse(at + e, read)
        out[:, :, i] = (less - more) / (2 * step)
    return out


def observed_error(
    effect: Effect, kind: str, parameters: Array, nav: Array, z: Array, dim: int
) -> Array:
    """What an observation of a kind reads too much, (m, dim), in the units of its residual.

    parameters (k,), or (m, k) where they change; nav (m, 21) as in ``observations``; z (m, Z_DIM).
    """
    address = int(effect.observation_error[kind])
    theta = np.empty((len(nav), len(effect.held) or np.shape(parameters)[-1]))
    if effect.held:
        theta[:] = effect.held
        theta[:, np.isnan(effect.held)] = parameters
    else:
        theta[:] = parameters
    out = np.zeros((len(nav), dim))
    call_residuals(address, np.ascontiguousarray(nav), theta, np.ascontiguousarray(z), out)
    return -out


@cache
def catalogue() -> Mapping[str, Effect]:
    """Every effect in this folder, by id."""
    found: dict[str, Effect] = {}
    for info in pkgutil.iter_modules(__path__):
        if info.name.startswith("_"):
            continue
        effect: Effect = importlib.import_module(f"{__name__}.{info.name}").EFFECT
        found[effect.id] = effect
    return found


def select(ids: Sequence[str]) -> tuple[Effect, ...]:
    """The effects of these ids, in that order. Raises InputError for one that is unknown."""
    known = catalogue()
    for i in ids:
        if i not in known:
            raise InputError(f"Unknown effect '{i}'. Known: {', '.join(sorted(known))}.")
    return tuple(known[i] for i in dict.fromkeys(ids))
