"""The catalogue of physics: one file an effect, and the folder listing is the catalogue.

A file defines ``EFFECT = Effect(...)`` and nothing else needs to know of it. Physics
enters in one of four ways:

- ``imu_error(parameters, signals) -> (n, 6)``: what the gyro (columns 0-2, rad/s) and
  the accelerometer (columns 3-5, m/s^2) read in addition, over a whole recording;
- ``observation_error``: for each kind of observation a compiled
  ``f(nav, parameters, z, r) -> 0`` that corrects the residual ``r`` in place. ``z[TIME]``
  is the time since the recording's start, s, ``z[WARMTH]`` the temperature less ``ROOM``, K;
- ``lateness``: for each kind of observation a compiled ``f(nav, parameters, z, out) -> 0`` that
  adds to ``out[0]`` by how many seconds its readings come late, beyond ``z[DELAY]``;
- ``seen``: for each kind of observation of one number ``columns(signals) -> (n, k)``, by what its
  readings are too large for a unit of each parameter, where that depends on more than a moment.

An effect that is noise brings a ``process`` instead: Markov states that walk with a bias
(``walks``) or that its ``observation_error`` takes for its parameters.

What an effect adds depends on the truth, of which only readings are known. Errors much
smaller than the signal are found by substitution; an effect that moves the signal as a
whole (a delay) brings ``imu_inverse(parameters, readings) -> (n, 6)``, the truth.

Effects come from this folder, from installed packages (entry points of the group
``handcal.effects``, each of them an ``Effect``), and, for as long as somebody asks for it, from
elsewhere: inside ``with_effects`` the catalogue is larger. Threads begun there have to be handed
the context (``contextvars.copy_context``, as ``estimate.parallel`` does), processes the files.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import entry_points
from typing import Protocol

import numpy as np

from handcal.compiled.jit import call_residuals
from handcal.did_you_mean import did_you_mean
from handcal.types import Array, BoolArray, InputError, Level, Markov, Recording, Result

# What an effect may need besides streams.
ATTITUDE, PLACE = "attitude", "place"
# Places in an observation's z that are the same for every kind; its own numbers are before them,
# and beyond Z_DIM if they are many.
DELAY, TIME, WARMTH, Z_DIM = 13, 14, 15, 16
# Courses that signals keep of what was worked out of them last: all of one product and its axes.
KEPT_COURSES = 24
# Temperature at which its effects are zero, degC.
ROOM = 25.0


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
    stream's name, with the columns and units of its row in ``recordings.streams``: all that no
    observation looks at, and what the effects need; only what the recording has, so an effect
    adds nothing where ``streams.get`` finds nothing. bias_temperature: degC, at which temperature
    errors are zero and biases are what they are. Made in ``handcal.signals``.
    """

    t: Array
    gyro: Array
    accel: Array
    C_nb: Array | None = field(default=None, kw_only=True)
    alpha: Array | None = field(default=None, kw_only=True)
    streams: Mapping[str, Array] = field(default_factory=dict, kw_only=True)
    bias_temperature: float = field(default=ROOM, kw_only=True)
    _worked_out: dict[tuple[object, ...], Array] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def once(self, key: tuple[object, ...], course: Callable[[], Array]) -> Array:
        """What is worked out of these signals, kept while it is asked for again and again."""
        found = self._worked_out.pop(key, None)
        self._worked_out[key] = course() if found is None else found
        if len(self._worked_out) > KEPT_COURSES:
            del self._worked_out[next(iter(self._worked_out))]
        return self._worked_out[key]

    @property
    def temperature(self) -> Array | None:
        """(n,) degC, None where the recording has none."""
        found = self.streams.get("temperature")
        return None if found is None else found[:, 0]

    @property
    def warmth(self) -> Array:
        """(n,) K above ``bias_temperature``, zero where the recording has no temperature."""
        found = self.temperature
        return np.zeros(len(self.t)) if found is None else found - self.bias_temperature


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
    observation tell. imu_error(p, signals): what gyro and accelerometer read too much, (n, 6).
    seen: for kinds of observation ("heading"), of the signals what a unit of each parameter
    makes it read too much, (n, parameters); observation_error: for kinds of observation the
    address of a compiled function of the state. delays: kinds of observation whose time its first
    parameter shifts, so that large ones can be found about a shifted time: ``z[DELAY]`` is
    the part already taken off. process: Markov states of noise, whose levels ``levels``
    have the parameters' names behind the id (``gyro_bias_walk_density``); walks: the reading
    they add to, "gyro" or "accel"; passing: what they add is no part of a bias. moments:
    reference points (k, p) to be tried, given the recording's times, where the error is not
    linear in all parameters (a step at an unknown moment); held: of an effect held at one, the
    parameters of its ``observation_error``, nan where they are free. outliers: for each kind of
    observation the probability density of a reading that is merely wrong, in a share of
    readings that is the first parameter. exclusive: ids of
    effects of which this one keeps only what they lack: together with one of them, its
    parameters are those of ``together @ parameters``; always so where there is a gauge but no such
    effect. last: with ``imu_inverse``, whether it is
    done to what the other effects made of the truth (a filter behind a scale error), or to the
    truth alone, beside them. akin: ids of effects of other sensors that
    are the same to the first order, and named where a recording does not tell them apart.
    made: of a law or a course found in a recording, its kind and its numbers.
    cost: nats of its prior odds that were spent on choosing its form among many.
    imitated: nats that a hand which turns the device about no single point can lend to this one,
    where only that point's rest tells where the device was.

    ``conceal`` and ``apply`` add and take off what all this says, the delays by shifting stamps.
    Where that is but an approximation, an effect brings its own ways: conceal(parameters,
    recording, known), the recording as a device with the effect makes it, and undo(parameters,
    recording), its reverse. world: it changes what there is to be measured, and is no error of
    a sensor. swings: what it adds to the accelerometer are parts that nearly cancel in the
    velocity. believed: for each kind of observation z (k, Z_DIM) with what others that act on
    it have to know of this one's parameters (k,), at which everything is linearised.
    of_one_day: another day it is another. sound(parameters, t (n,), valid (n,)): which readings
    depend on measurements alone, where what is read depends on other moments. instead: the
    effect that is the same on a stream on which this one does not act. baseline: it is in every
    model (a state of the filter), so it is never on trial. always: the online filter starts with
    it, as with biases. common: every device has it, so every fit of a recording that could show it
    estimates it; where that and the usual size are from ("": rare, tried beside those). Of errors
    that stand in for each other one is common. tails: its prior has the wide scales that others
    have. features(truth): of an effect
    linear in its parameters, where that comes cheaper than differences of ``imu_error``: a
    channel (0 to 5), the first of the parameters that act on it, and the derivatives by these,
    (n, m). proportional: what ``imu_error`` adds is a matrix (6, 6) times rate and force of the
    same moment, and nothing else.
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
    lateness: Mapping[str, int] = field(default_factory=dict)
    seen: Mapping[str, Callable[[Signals], Array]] = field(default_factory=dict)
    imu_inverse: Callable[[Array, Signals], Array] | None = None
    needs: tuple[str, ...] = ()
    delays: tuple[str, ...] = ()
    process: Markov | None = None
    levels: tuple[Level, ...] = ()
    walks: str = ""
    passing: bool = False
    moments: Callable[[Array], Array] | None = None
    held: tuple[float, ...] = ()
    outliers: Mapping[str, float] = field(default_factory=dict)
    exclusive: tuple[str, ...] = ()
    together: Array | None = None
    last: bool = True
    akin: tuple[str, ...] = ()
    cost: float = 0.0
    imitated: float = 0.0
    made: tuple[str, tuple[float, ...]] | None = None
    conceal: Callable[[Array, Recording, Known], Recording] | None = None
    undo: Callable[[Array, Recording], Recording] | None = None
    world: bool = False
    swings: bool = False
    believed: Mapping[str, Callable[[Array, Array], Array]] = field(default_factory=dict)
    of_one_day: bool = False
    sound: Callable[[Array, Array, BoolArray], BoolArray] | None = None
    instead: str = ""
    baseline: bool = False
    always: bool = False
    common: str = ""
    tails: bool = True
    features: Callable[[Signals], Sequence[tuple[int, int, Array]]] | None = None
    proportional: bool = False

    @property
    def misreads(self) -> bool:
        """Whether gyro or accelerometer read something else for it, whatever is noise apart."""
        return self.imu_error is not None and not self.world and self.process is None

    @property
    def prior_sigma(self) -> Array:
        """Prior standard deviations (k,) in the order of the parameters."""
        return np.array([p.prior_sigma for p in self.parameters])

    @property
    def acts_on(self) -> frozenset[str]:
        """Kinds of observation whose readings it changes."""
        return self.acts_now_on | frozenset(self.seen)

    @property
    def acts_now_on(self) -> frozenset[str]:
        """Kinds of observation whose readings it changes by what is at that moment."""
        return frozenset(self.observation_error) | frozenset(self.lateness)


def imu_jacobian(effect: Effect, at: Array, signals: Signals) -> Array:
    """Derivative (n, 6, k) of an effect's IMU error by its parameters, at ``at`` (k,).

    A central difference with steps of a thousandth of the prior: exact for effects
    linear in their parameters, as most are.
    """
    if effect.features is not None:
        out = np.zeros((len(signals.t), 6, len(effect.parameters)))
        for channel, first, columns in effect.features(signals):
            out[:, channel, first : first + columns.shape[1]] = columns
        return out
    if effect.imu_error is None:
        return np.zeros((len(signals.t), 6, len(at)))
    return np.stack(list(_slopes(effect.imu_error, effect.prior_sigma, at, signals)), axis=2)


def correction_slopes(effect: Effect, at: Array, truth: Signals) -> Iterator[Array]:
    """Derivative (n, 6) of what is taken off the readings by each of an effect's parameters.

    To first order in the error that of the error itself. For an effect that moves the signal as a
    whole it is not: what a later moment's reading says of this one changes as the truth of this
    moment does, not as the reading of the later one.
    """
    assert effect.imu_error is not None
    if effect.imu_inverse is None:
        yield from _slopes(effect.imu_error, effect.prior_sigma, at, truth)
        return
    error = effect.imu_error(at, truth)
    read = replace(truth, gyro=truth.gyro + error[:, :3], accel=truth.accel + error[:, 3:])
    # (a larger correction means a smaller truth)
    yield from (-slope for slope in _slopes(effect.imu_inverse, effect.prior_sigma, at, read))


def _slopes(
    function: Callable[[Array, Signals], Array], size: Array, at: Array, signals: Signals
) -> Iterator[Array]:
    for i, step in enumerate(1e-3 * size):
        e = np.zeros(len(size))
        e[i] = step
        difference = function(at + e, signals) - function(at - e, signals)
        difference /= 2.0 * step
        yield difference


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


def seen_columns(effect: Effect, kind: str, signals: Signals, t: Array) -> Array:
    """What a unit of each parameter of an effect makes an observation of a kind (``Effect.seen``)
    read too much at times t (m,), (m, k)."""
    columns = effect.seen[kind](signals).T
    return np.stack([np.interp(t, signals.t, column) for column in columns], axis=1)


class Catalogue(dict[str, Effect]):
    """Effects by id. Equal to itself alone, so that what was worked out of it can be kept by it."""

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:  # type: ignore[override]
        return id(self)


# None: what is installed, and nothing more.
_LARGER: ContextVar[Catalogue | None] = ContextVar("catalogue", default=None)


def catalogue() -> Catalogue:
    """Every effect by id: those that are installed, and those that ``with_effects`` adds here."""
    return _LARGER.get() or installed()


@cache
def installed() -> Catalogue:
    """The effects of this folder and of installed packages. Raises InputError where a package has
    something else to offer, or an effect of which there is one already."""
    own = []
    for info in pkgutil.iter_modules(__path__):
        if not info.name.startswith("_"):
            own.append((info.name, importlib.import_module(f"{__name__}.{info.name}").EFFECT))
    return _joined(_joined(Catalogue(), own), _of_packages())


def _of_packages() -> Iterator[tuple[str, Effect]]:
    """Where each effect of an installed package comes from, and the effect."""
    for entry in entry_points(group="handcal.effects"):
        whose = f" of {entry.dist.name}" if entry.dist else ""
        where = f"The installed effect '{entry.name}'{whose}"
        try:
            effect = entry.load()
        except Exception as error:  # whatever a stranger's module may raise
            raise InputError(f"{where} cannot be loaded: {error}.") from error
        if not isinstance(effect, Effect):
            raise InputError(f"{where} is no Effect: {entry.value}.")
        yield where, effect


@contextmanager
def with_effects(more: Iterable[tuple[str, Effect]]) -> Iterator[None]:
    """Inside, the catalogue has these effects too; each comes with a name of where it is from.

    Raises InputError for a second effect of the same id.
    """
    token = _LARGER.set(_joined(catalogue(), more))
    try:
        yield
    finally:
        _LARGER.reset(token)


@contextmanager
def with_laws(laws: Iterable[Effect]) -> Iterator[None]:
    """Inside, the catalogue has these laws too, under their formulas."""
    token = _LARGER.set(Catalogue({**catalogue(), **{law.id: law for law in laws}}))
    try:
        yield
    finally:
        _LARGER.reset(token)


def _joined(known: Catalogue, more: Iterable[tuple[str, Effect]]) -> Catalogue:
    out, origin = Catalogue(known), dict.fromkeys(known, "the catalogue")
    for where, effect in more:
        if not effect.id.isidentifier():
            raise InputError(f"{where}: an effect's id is one word, not '{effect.id}'.")
        if effect.id in out:
            raise InputError(
                f"{where} has an effect '{effect.id}', and so has {origin[effect.id]}: "
                "give it another id."
            )
        out[effect.id], origin[effect.id] = effect, where
    return out


def select(ids: Sequence[str]) -> tuple[Effect, ...]:
    """The effects of these ids, in that order. Raises InputError for one that is unknown."""
    return tuple(known_effect(i) for i in dict.fromkeys(ids))


def known_effect(effect_id: str) -> Effect:
    """The effect of this id. Raises InputError with a list of those that there are."""
    known = catalogue()
    if effect_id not in known:
        meant = did_you_mean(effect_id, known, most=3)
        raise InputError(
            f"Unknown effect '{effect_id}'.{meant} Known: {', '.join(sorted(known))}; files of "
            "your own come with --effects-from."
        )
    return known[effect_id]
