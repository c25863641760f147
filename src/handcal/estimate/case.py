"""A recording made ready for explaining: what is observed, which effects it could show."""

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

# A recording of which no more than this lies outside its rests is one of a device that lies, s.
BESIDE_S = 1.0


@dataclass(frozen=True)
class Edit:
    """Readings of one kind that are merely wrong: ``dropped``, numbers of the rows left out;
    shifted: from, to (s) and by how much (rad) others are turned back, or (m) the held point is
    moved; constant: log-evidence of what was left out, less what is paid for the rest."""

    kind: str
    dropped: tuple[int, ...]
    shifted: tuple[float, float, float] | None
    constant: float


@dataclass(frozen=True)
class Case:
    """One recording and all that does not change with the model.

    observed: kinds with their rows and constants; delays: s by which the readings of a kind
    are taken to come late, for linearising about; fixed: noise levels that are known;
    constant: log-evidence of readings that are held to be outliers and left out; read: the
    recording as it was read, of which ``recording`` may hold averages; noise_until: noise levels
    are found in what comes before, s; edits: what was made of the rows; iron: hard iron (3,) with
    which the first trajectory begins, and its sigmas (3,), tesla. before: what is known of the
    device.
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
# A difference of so much iron (tesla) leads no start astray.
MUCH_IRON = 5e-6
# Readings of an IMU a second that explain a hand as well as more would.
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
    """A recording with what is observed of it; ``auto`` begins with a held point, since errors of
    the sensors look like a travelling hand.

    kinds: of observation, instead of those that streams and ``assume`` suggest; fixed: noise
    levels that are known, SI; start: a prior of the first state instead of levelling;
    reference_exact: a reference has no bias; before: what is known of the device.
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
        # What lies still turns no more than the Earth does, whatever point is held.
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
    """The case with this made of the rows of one kind."""
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

    A hand does nothing within a hundredth of a second, and the mean of a few readings holds
    all they say of an angle; the time it takes to explain them falls with their number. What a
    reference says at one instant is not what a mean says: it is averaged in the same way.
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
    """Mean rate and force (k, 3) of groups (k, g, 3) read at times (k, g).

    The axes turn meanwhile: forces are averaged in the axes of the middle (sculling; while the
    device turns at 500 deg/s, a plain mean over 10 ms would lose 3 mm/s^2 of gravity), and of the
    turns it counts that they come one after the other (coning). Savage, Journal of Guidance,
    Control and Dynamics 21 (1998), to the second order.
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
    """A reference (rate and force) averaged over so many instants, spread evenly over ``width``
    s about each of its stamps that has as much on both sides."""
    if len(series.t) < 4:
        return series
    from scipy.interpolate import CubicSpline

    offsets = width / count * (np.arange(count) - 0.5 * (count - 1))
    t = series.t[(series.t + offsets[0] >= series.t[0]) & (series.t + offsets[-1] <= series.t[-1])]
    value = CubicSpline(series.t, series.value)(t[:, None] + offsets)
    mean = _mean(t[:, None] + offsets, value[:, :, :3], value[:, :, 3:])
    return Series(t, np.hstack(mean))


def other_irons(case: Case) -> list[Case]:
    """The case begun with other hard irons of its magnetometer, where its readings do not show
    which it is: other spheres on which they may lie, and none at all."""
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
    """The case's problem with these effects, not linearised yet."""
    observed = [
        (o, replace(rows, delay=case.delays.get(o.kind, 0.0)), constants)
        for o, rows, constants in case.observed
    ]
    return build(case.recording, effects, observed, *case.earth, rests=case.rests, linearised=False)


def applicable(case: Case, effect: Effect) -> bool:
    """Whether this recording could show the effect at all, and has to be asked."""
    if effect.baseline:
        return False
    if any(n not in (ATTITUDE, PLACE, *case.recording.streams) for n in effect.needs):
        return False
    if PLACE in effect.needs and not any(o.places for o, _, _ in case.observed):
        return False
    if ATTITUDE in effect.needs and not any(o.navigates for o, _, _ in case.observed):
        # beside a reference nothing is integrated: what changes the world, both sensors feel
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
    """Whether the device rests all the while, so that no error can go with its motion."""
    still = float(np.diff(case.rests, axis=1).sum()) if len(case.rests) else 0.0
    return still > case.recording.duration_s - BESIDE_S


def frozen_at(effect: Effect, moment: Array) -> Effect:
    """The effect with what it is not linear in held at ``moment`` (p,): only the rest is free.

    The parameters that are not zero at the moment are the ones held.
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
    """Why there is no result, with what was odd about the recordings themselves: that may be it."""
    said = dict.fromkeys(w for r in recordings for w in r.warnings)
    also = f" Of the readings: {' '.join(said)}" if said else ""
    return HandcalError(
        "The filter diverged on this recording; check its units and axes, and whether the "
        f"device was really held or laid as assumed.{also}"
    )
