"""A recording prepared for a fit: its observations, and the effects that it could show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from handcal.compiled import so3
from handcal.earth import local_earth
from handcal.effects import ATTITUDE, PLACE, Effect, Signals, mag_hard_iron
from handcal.estimate.assemble import build
from handcal.estimate.observed import Choice, Observed, choose, observed_of
from handcal.estimate.problem import Problem
from handcal.estimate.start import Start, with_known_biases
from handcal.observations.fixed_position import CREEPING
from handcal.recordings import segment
from handcal.recordings.bridged import bridged
from handcal.signals import at_its_temperature
from handcal.types import Array, HandcalError, Prior, Recording, Series

# Largest time outside rests in a recording of a device at rest, s.
BESIDE_S = 1.0


@dataclass(frozen=True)
class Edit:
    """An edit of one kind of observation.

    dropped: indices of rows left out as outliers. shifted: from, to (s), and the angle (rad) by
    which headings are turned back, or the distance (m) that the held point moves. constant:
    log-evidence of the dropped rows, less the cost of the shift.
    """

    kind: str
    dropped: tuple[int, ...]
    shifted: tuple[float, float, float] | None
    constant: float


@dataclass(frozen=True)
class Case:
    """One recording and all that does not change with the model.

    observed: kinds with their rows and constants. delays: of each kind of observation, s, to
    linearise about. fixed: noise levels that are known, SI. constant: log-evidence of dropped
    outliers. read: the recording before averaging (``recording`` may hold averages). noise_until:
    end of the part in which noise levels are estimated, s. edits: changes of the rows. iron:
    initial hard iron (3,) and its sigmas (3,), tesla. before: prior of the device.
    """

    recording: Recording
    assume: str
    observed: tuple[Observed, ...]
    rests: Array
    earth: tuple[Array, Array]
    start: Start
    warnings: tuple[str, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    delays: Mapping[str, float] = field(default_factory=dict)
    constant: float = 0.0
    read: Recording | None = None
    noise_until: float | None = None
    edits: tuple[Edit, ...] = ()
    iron: tuple[Array, Array] | None = None
    before: Prior | None = None

    @property
    def creeping(self) -> bool:
        """Whether the hand's held point may creep."""
        return any(o is CREEPING for o, _, _ in self.observed)

    @property
    def moves(self) -> bool:
        """Whether the hand's held point moves to another place."""
        return any(e.kind == CREEPING.kind and e.shifted is not None for e in self.edits)

    @property
    def kinds(self) -> tuple[str, ...]:
        return tuple(o.kind for o, _, _ in self.observed)


HELD = "held"
# Hard iron error with which a start still converges, tesla.
MUCH_IRON = 5e-6
# Least IMU rate after averaging: a hand has nothing faster to show.
ENOUGH_HZ = 90.0


def case_of(
    recording: Recording,
    assume: str = "auto",
    latitude: float | None = None,
    height: float = 0.0,
    ignore: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
    *,
    kinds: Sequence[str] | None = None,
    start: Start | None = None,
    reference_exact: bool = False,
    before: Prior | None = None,
) -> Case:
    """A recording with its observations. With ``auto`` the point is assumed held, since sensor
    errors look like a travelling hand.

    kinds: of observation, instead of those that streams and ``assume`` imply. fixed: noise levels
    that are known, SI. start: prior of the first state instead of levelling. reference_exact: a
    reference has no bias. before: prior of the device.
    """
    read = replace(
        recording, streams={k: v for k, v in recording.streams.items() if k not in ignore}
    )
    read = bridged(at_its_temperature(read))
    recording = thinned(read)
    rests = segment.rests(recording)
    earth = local_earth(latitude, height)
    if kinds is None:
        choice = _chosen(recording, assume, rests, reference_exact)
    else:
        choice = Choice("rest-only" if "zero_rate" in kinds else "fixed-point", tuple(kinds), ())
    observed, begin = observed_of(
        recording, choice.kinds, rests, earth, start, reference_exact=reference_exact
    )
    return Case(
        recording,
        choice.assume,
        tuple(observed),
        rests,
        earth,
        with_known_biases(begin, before),
        (*recording.warnings, *choice.warnings),
        dict(fixed or {}),
        read=read,
        iron=_iron(recording) if "magnetometer" in choice.kinds else None,
        before=before,
    )


def _chosen(recording: Recording, assume: str, rests: Array, reference_exact: bool) -> Choice:
    choice = choose(recording, assume, rests, reference_exact)
    if "fixed_position" in choice.kinds and segment.at_rest(recording):
        # A device at rest turns with the Earth only.
        return replace(choice, kinds=(*choice.kinds, "zero_rate"))
    return choice


def _iron(recording: Recording) -> tuple[Array, Array]:
    best = mag_hard_iron.spheres(recording)[0]
    return best.centre, best.sigma


def creeping(case: Case) -> Case:
    """The case with a held point that may creep (an arm that tires)."""
    observed = tuple(
        (CREEPING if o.kind == CREEPING.kind else o, rows, constants)
        for o, rows, constants in case.observed
    )
    return replace(case, observed=observed)


def edited(case: Case, edit: Edit) -> Case:
    """The case with an edit applied to the rows of one kind."""
    observed = list(case.observed)
    k = case.kinds.index(edit.kind)
    observation, rows, constants = observed[k]
    z, moved = rows.z.copy(), rows.moved
    if edit.shifted is not None:
        first, last, by = edit.shifted
        there = (rows.t >= first) & (rows.t <= last)
        if observation.kind == CREEPING.kind:
            moved = np.zeros(len(rows.t)) if moved is None else moved.copy()
            moved[(rows.t > last) & (np.r_[-math.inf, rows.t[:-1]] <= last)] = by
        else:
            z[there, 0] = so3.wrap(z[there, 0] - by)
    kept = np.ones(len(rows.t), dtype=bool)
    kept[list(edit.dropped)] = False
    moved = None if moved is None else moved[kept]
    rows = replace(rows, t=rows.t[kept], z=z[kept], moved=moved)
    observed[k] = (observation, rows, constants)
    constant = case.constant + edit.constant
    return replace(case, observed=tuple(observed), constant=constant, edits=(*case.edits, edit))


def thinned(recording: Recording) -> Recording:
    """A fast IMU's readings averaged in groups, so that at least ENOUGH_HZ are left.

    A hand does nothing within 10 ms, and a mean keeps all the information of a few readings on an
    angle. The run time falls with their number. A reference is averaged over the same spans.
    """
    group = int(recording.rate_hz / ENOUGH_HZ)
    if group < 2:
        return recording
    imu = recording.imu
    n = len(imu.t) // group * group
    t = imu.t[:n].reshape(-1, group)
    gyro, accel = _mean(t, *(x[:n].reshape(-1, group, 3) for x in (imu.gyro, imu.accel)))
    steps = np.diff(t, axis=1)
    whole = (steps < 4.0 * np.median(np.diff(imu.t))).all(axis=1)
    valid = np.array(imu.valid[:n].reshape(-1, group).all(axis=1) & whole)
    streams = dict(recording.streams)
    if "reference" in streams:
        streams["reference"] = _averaged(streams["reference"], group / recording.rate_hz, group)
    return replace(
        recording,
        imu=replace(imu, t=t.mean(axis=1), gyro=gyro, accel=accel, valid=valid),
        streams=streams,
    )


def _mean(t: Array, gyro: Array, accel: Array) -> tuple[Array, Array]:
    """Mean rate and force (k, 3) of groups (k, g, 3) at times (k, g) s, corrected for the rotation
    within a group.

    Forces are averaged in the axes of the middle (sculling): at 500 deg/s a plain mean over 10 ms
    would lose 3 mm/s^2 of gravity. Rates are corrected for the order of rotations (coning). Savage,
    Journal of Guidance, Control and Dynamics 21 (1998), to second order.
    """
    count = t.shape[1]
    rate = gyro.mean(axis=1)
    away = (t - t.mean(axis=1, keepdims=True))[:, :, None]
    turn = np.cross(rate[:, None, :], accel)
    force = accel + away * turn + 0.5 * away**2 * np.cross(rate[:, None, :], turn)
    step = (t[:, -1] - t[:, 0])[:, None] / max(count - 1, 1)
    before = np.cumsum(gyro, axis=1) - gyro
    coning = 0.5 * step / count * np.cross(before, gyro).sum(axis=1)
    return rate + coning, force.mean(axis=1)


def _averaged(series: Series, width: float, count: int) -> Series:
    """A reference (rate and force) averaged over ``count`` instants, spread evenly over ``width``
    s about each stamp. Stamps too close to either end are dropped."""
    if len(series.t) < 4:
        return series
    from scipy.interpolate import CubicSpline

    offsets = width / count * (np.arange(count) - 0.5 * (count - 1))
    t = series.t[(series.t + offsets[0] >= series.t[0]) & (series.t + offsets[-1] <= series.t[-1])]
    value = CubicSpline(series.t, series.value)(t[:, None] + offsets)
    mean = _mean(t[:, None] + offsets, value[:, :, :3], value[:, :, 3:])
    return Series(t, np.hstack(mean))


def other_irons(case: Case) -> list[Case]:
    """Alternative starts of a case whose magnetometer readings leave the hard iron ambiguous: the
    centres of the other spheres that fit them, and no iron."""
    if "magnetometer" not in case.kinds:
        return []
    best, *others = mag_hard_iron.spheres(case.recording)
    found = [(s.centre, s.sigma) for s in others]
    known = float(best.sigma.max()) < MUCH_IRON
    if not known and all(np.linalg.norm(s.centre) > MUCH_IRON for s in (best, *others)):
        found.append((np.zeros(3), np.full(3, mag_hard_iron.STRAY)))
    return [_with_iron(case, *f) for f in found]


def _with_iron(case: Case, iron: Array, sigma: Array) -> Case:
    observed, start = observed_of(case.recording, case.kinds, case.rests, case.earth, None, iron)
    start = with_known_biases(start, case.before)
    out = replace(
        case, observed=tuple(observed), start=start, constant=0.0, edits=(), iron=(iron, sigma)
    )
    out = creeping(out) if case.creeping else out
    for edit in case.edits:
        out = edited(out, edit)
    return out


def problem_with(case: Case, effects: Sequence[Effect]) -> Problem:
    """The case's problem with these effects, before linearisation."""
    observed = [
        (o, replace(rows, delay=case.delays.get(o.kind, 0.0)), constants)
        for o, rows, constants in case.observed
    ]
    return build(case.recording, effects, observed, *case.earth, rests=case.rests, linearised=False)


def applicable(case: Case, effect: Effect) -> bool:
    """Whether this recording could show the effect, so that it is a candidate."""
    if effect.baseline:
        return False
    if any(n not in (ATTITUDE, PLACE, *case.recording.streams) for n in effect.needs):
        return False
    if PLACE in effect.needs and not any(o.places for o, _, _ in case.observed):
        return False
    if ATTITUDE in effect.needs and not any(o.navigates for o, _, _ in case.observed):
        # (beside a reference nothing is integrated, and both sensors see the same world)
        return bool(set(case.kinds) & effect.acts_on)
    if effect.id == "earth_rate" and bool(np.any(case.earth[1])):
        return False
    if effect.passing and effect.process is not None and _lies(case):
        return False
    kinds = set(case.kinds)
    if effect.imu_error is not None or effect.walks:
        return True
    return bool(kinds & (effect.acts_on | set(effect.outliers)))


def _lies(case: Case) -> bool:
    """Whether the device rests throughout, so that errors with its motion cannot show."""
    still = float(np.diff(case.rests, axis=1).sum()) if len(case.rests) else 0.0
    return still > case.recording.duration_s - BESIDE_S


def frozen_at(effect: Effect, moment: Array) -> Effect:
    """The effect with its nonlinear parameters (a moment) held at the values in ``moment`` (p,).

    Parameters that are zero in ``moment`` stay free; the others are held.
    """
    free = np.flatnonzero(moment == 0.0)
    error = effect.imu_error

    def held(parameters: Array, signals: Signals) -> Array:
        assert error is not None
        whole = moment.copy()
        whole[free] = parameters
        return error(whole, signals)

    numbers = np.where(moment == 0.0, np.nan, moment).tolist()
    return replace(
        effect,
        id=f"{effect.id}@{moment[moment != 0.0][0]:.3f}",
        parameters=tuple(effect.parameters[i] for i in free),
        imu_error=None if error is None else held,
        moments=None,
        held=tuple(numbers) if effect.acts_on else (),
        made=(HELD, tuple(float(x) for x in moment)),
    )


def name_of(effect_id: str) -> str:
    """The catalogue's id of an effect that may be held at a moment."""
    return effect_id.split("@")[0]


def no_fit(recordings: Sequence[Recording]) -> HandcalError:
    """The error of a diverged fit, with the recordings' warnings, which may be the cause."""
    said = dict.fromkeys(w for r in recordings for w in r.warnings)
    also = f" Of the readings: {' '.join(said)}" if said else ""
    return HandcalError(
        "The filter diverged on this recording; check its units and axes, and whether the "
        f"device was really held or laid as assumed.{also}"
    )
