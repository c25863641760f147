"""What matters: what each effect does to the readings, how much of the mismatch is its own, and
whether data that the fit has not seen agree that it is there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from handcal.compiled.kernel import BASE
from handcal.device.twin import IMU_CHANNELS
from handcal.effects import Effect, Signals
from handcal.estimate.case import name_of
from handcal.estimate.corrected import corrected_readings
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.linear import known_linear
from handcal.estimate.model import Fitted, Model
from handcal.estimate.problem import Problem
from handcal.estimate.quadratic import Quadratic, local, total
from handcal.explain.held_out import early_part
from handcal.explanation import Missing
from handcal.recordings.streams import observed_by
from handcal.search.multistart import Found
from handcal.search.space import Space, expected_gain, space
from handcal.signals import reading
from handcal.types import Array, IntArray, Recording, Result

# Nats that unseen data must promise of an effect before they are asked for their opinion.
TOLD = 3.0


@dataclass(frozen=True)
class Judged:
    """Two scans about the same fit: of the data that were fitted, and of these and later ones;
    by how much noise effects were missed in the later ones, nats by id."""

    seen: Space
    whole: Space
    noise: Mapping[str, float] = field(default_factory=dict)


def by_later_blocks(found: Found) -> Judged | None:
    """Later parts of the recordings, as seen from the earlier ones, at the final noise levels; None
    where there is no effect to judge."""
    model = found.model
    if not model.effects:
        return None
    parts = (replace(f, about=known_linear(early_part(f.linear))) for f in model.parts)
    early = replace(model, parts=tuple(parts))
    noise: dict[str, float] = {}
    for e in (e for e in model.effects if e.process is not None):
        whole, seen = (sum(_missed(f, e) for f in m.parts) for m in (model, early))
        # (other noise makes up for some of it, once it has the chance)
        noise[e.id] = found.noise[e.id] * (whole - seen) / max(whole, found.noise[e.id], 1.0)
    return Judged(_space(found, early), _space(found, model), noise)


def by_other_files(found: Found, after: Model) -> Judged:
    """Recordings that took no part; after: the final model's fit to them."""
    whole = replace(after, parts=(*found.model.parts, *after.parts))
    noise = {
        e.id: sum(_missed(f, e) for f in after.parts)
        for e in after.effects
        if e.process is not None
    }
    same = replace(found.model, effects=after.effects)
    return Judged(_space(found, same), _space(found, whole), noise)


def _space(found: Found, model: Model) -> Space:
    """What the model's parts say of its effects, about their fits as they are."""
    own = [e for e in model.effects if e.process is None]
    ids, worth = frozenset(e.id for e in own), found.space.quadratic.worth
    parts = [local(reduced_pass(reduce(f.linear), f.levels), ids).quadratic for f in model.parts]
    powers = [Quadratic(q.names, q.a, worth * q.b, worth * q.G, worth) for q in parts]
    return space(total(powers), own, found.space.prior)


def weighed(
    found: Found, missing: Missing, judged: Judged | None, left_out: float = 0.0
) -> Missing:
    """What is missing with its size, its share and what unseen data gain by it; left_out: nats
    gained by readings that the model does without."""
    effect = _in_model(found.model, missing)
    always = effect is not None and effect.always
    whole = max(whole_gain(found, always) + left_out, 1e-9)
    share = float(np.clip(missing.log_evidence_gain / whole, 0.0, 1.0))
    if effect is None:
        return replace(missing, share=share)
    return replace(
        missing,
        size=sizes(found.model, effect),
        share=share,
        held_out_gain=None if judged is None else _held_out(found, judged, effect),
    )


def _in_model(model: Model, missing: Missing) -> Effect | None:
    """The effect of the model that is told by this name, or by that of another of its set."""
    by_name = {name_of(e.id): e for e in reversed(model.effects)}
    names = missing.effect, *missing.indistinguishable_from
    return next((by_name[i] for i in names if i in by_name), None)


def whole_gain(found: Found, from_nothing: bool = False) -> float:
    """Nats that all of the final model's effects gain together, at its noise levels, over the
    baseline; from_nothing: over a model without even those that every model has."""
    where, chosen = found.space, found.model.chosen
    always = frozenset(e.id for e in found.model.effects if e.always and not from_nothing)
    with_, without = (
        where.score(ids) - sum(where.prior[i] for i in ids) for ids in (chosen, always)
    )
    return with_ - without + sum(found.noise.get(e.id, 0.0) for e in found.model.effects)


def _held_out(found: Found, judged: Judged, effect: Effect) -> float | None:
    """Nats on unseen data with the effect against without it; None where they would not tell."""
    if effect.id in judged.noise:
        return judged.noise[effect.id]
    if effect.id not in judged.whole.effects:
        return None
    chosen = frozenset(judged.whole.effects)
    u = found.model.u[[n[0] == effect.id for n in found.model.quadratic.names]]
    promised = [expected_gain(w, effect.id, chosen, u) for w in (judged.whole, judged.seen)]
    if promised[0] - promised[1] < TOLD:
        return None
    whole, seen = (
        w.score(chosen) - w.score(chosen - {effect.id}) for w in (judged.whole, judged.seen)
    )
    return float(whole - seen)


def _missed(f: Fitted, effect: Effect) -> float:
    """Nats by which the data would be less likely without the noise effect, all else kept."""
    without = dict(f.levels) | {lv.name: lv.lower for lv in effect.levels}
    reduction = reduce(f.linear)
    here, there = (reduced_pass(reduction, lv).log_evidence for lv in (f.levels, without))
    return here - there


def sizes(model: Model, effect: Effect, spread: bool = False) -> dict[str, float]:
    """Root mean square of what the effect adds to each channel's readings, SI, to first order;
    channels on which it does not act are left out. spread: about its mean in a recording, which a
    bias holds as well."""
    squares: dict[str, list[Array]] = {}
    for f in model.parts:
        for channel, x in _added(f, effect).items():
            squares.setdefault(channel, []).append((x - spread * x.mean()) ** 2)
    rms = {c: float(np.sqrt(np.mean(np.concatenate(x)))) for c, x in squares.items()}
    return {c: v for c, v in rms.items() if v > 0.0}


def _added(f: Fitted, effect: Effect) -> dict[str, Array]:
    """What the effect adds to each channel, at the times at which it is looked at."""
    linear, problem = f.linear, f.linear.problem
    constants, states = _columns(problem, effect)
    value = linear.trajectory.constants[constants]
    out: dict[str, Array] = {}
    imu = constants[constants < problem.imu_constants]
    if len(imu) and problem.slopes is not None:
        own = np.zeros(problem.constants)
        own[imu] = value[: len(imu)]
        added = problem.slopes.times(own)
        out |= {c: added[:, k] for k, c in enumerate(IMU_CHANNELS)}
    if effect.walks:
        first = 0 if effect.walks == "gyro" else 3
        walk = linear.trajectory.markov[:, states]
        walk = walk - walk.mean(axis=0)
        return {c: walk[:, k] for k, c in enumerate(IMU_CHANNELS[first : first + 3])}
    seen = [o for o in problem.observations if o.kind in effect.acts_on]
    if effect.conceal is not None and seen and not any(observed_by(o.kind) for o in seen):
        return _swung(f, effect, value)
    at = np.repeat(np.arange(len(linear.t)), np.diff(linear.first))
    for k, observation in enumerate(problem.observations):
        if observation not in seen or observed_by(observation.kind) is None:
            continue
        mine = (linear.kind == k) & linear.used
        H = linear.H[mine, : observation.dim]
        added = H[:, :, BASE + constants] @ value
        moving = linear.trajectory.markov[at[mine]][:, states]
        added = added + np.einsum("kij,kj->ki", H[:, :, BASE + problem.constants + states], moving)
        out |= {c: added[:, i] for i, c in enumerate(observation.channels)}
    return out


@dataclass(frozen=True)
class _Alone:
    """What a fit knows of the truth, for effects that are told by the hand: the IMU alone."""

    recording: Recording
    signals: Signals

    @property
    def unbiased(self) -> Signals:
        return self.signals

    def result(self, beside: tuple[str, ...] = ()) -> Result:
        raise NotImplementedError

    def attitude(self, t: Array, beside: tuple[str, ...] = ()) -> Array:
        raise NotImplementedError


def _swung(f: Fitted, effect: Effect, value: Array) -> dict[str, Array]:
    """What an effect of which only the held point tells adds to the IMU's readings."""
    assert effect.conceal is not None
    problem, nominal = f.linear.problem, f.linear.trajectory
    done = corrected_readings(problem, nominal.constants, nominal.bg, nominal.ba)
    alone = replace(problem.recording, streams={})
    known = _Alone(alone, reading(done.read, done.raw - done.error))
    imu = effect.conceal(value, alone, known).imu
    added = np.hstack([imu.gyro - alone.imu.gyro, imu.accel - alone.imu.accel])
    return {c: added[:, k] for k, c in enumerate(IMU_CHANNELS)}


def _columns(problem: Problem, effect: Effect) -> tuple[IntArray, IntArray]:
    """Places of the effect among the constants, and of its process among the Markov states."""
    constants: IntArray = np.flatnonzero([s.owner == effect.id for s in problem.slots])
    return constants, problem.states_of(effect.process)
