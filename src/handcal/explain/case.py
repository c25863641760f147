"""A recording made ready for explaining: what is observed in it, and which effects it could show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from handcal import segment
from handcal.calibration import Observed, choose, observed_of
from handcal.earth import local_earth
from handcal.effects import Effect, Signals, catalogue
from handcal.model import Problem, build
from handcal.start import Start
from handcal.types import Array, Recording


@dataclass(frozen=True)
class Case:
    """One recording and all that does not change with the model.

    observed: kinds with their rows and constants; delays: s by which the readings of a kind
    are taken to come late, for linearising about; fixed: noise levels that are known;
    constant: log-evidence of readings that are held to be outliers and left out.
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

    @property
    def kinds(self) -> tuple[str, ...]:
        return tuple(o.kind for o, _, _ in self.observed)


def case_of(
    recording: Recording,
    assume: str = "auto",
    latitude: float | None = None,
    height: float = 0.0,
    ignore: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
) -> Case:
    """Choose what is observed as ``calibrate`` does, but that ``auto`` begins with a held point."""
    recording = replace(
        recording, streams={k: v for k, v in recording.streams.items() if k not in ignore}
    )
    rests = segment.rests(recording)
    earth = local_earth(latitude, height)
    # Errors of the sensors look like a travelling hand; whether it travels is asked at the end.
    held = "fixed-point" if assume == "auto" else assume
    assume, kinds, warnings = choose(
        recording, tuple(catalogue().values()), held, rests, earth, dict(fixed or {})
    )
    observed, start = observed_of(recording, kinds, rests, earth, None)
    return Case(
        recording,
        assume,
        tuple(observed),
        rests,
        earth,
        start,
        (*recording.warnings, *warnings),
        dict(fixed or {}),
    )


def problem_with(case: Case, effects: Sequence[Effect]) -> Problem:
    """The case's problem with these effects, not linearised yet."""
    observed = [
        (o, replace(rows, delay=case.delays.get(o.kind, 0.0)), constants)
        for o, rows, constants in case.observed
    ]
    return build(case.recording, effects, observed, *case.earth, linearised=False)


def applicable(case: Case, effect: Effect) -> bool:
    """Whether this recording could show the effect at all."""
    for need in effect.needs:
        if need != "attitude" and need not in case.recording.streams:
            return False
    if effect.id == "earth_rate" and bool(np.any(case.earth[1])):
        return False
    kinds = set(case.kinds)
    if effect.imu_error is not None or effect.walks:
        return True
    return bool(kinds & (set(effect.observation_error) | set(effect.outliers)))


def frozen_at(effect: Effect, moment: Array) -> Effect:
    """The effect with what it is not linear in held at ``moment`` (p,): only the rest is free.

    The parameters that are not zero at the moment are the ones held.
    """
    free = np.flatnonzero(moment == 0.0)
    assert effect.imu_error is not None
    error = effect.imu_error

    def held(parameters: Array, signals: Signals) -> Array:
        whole = moment.copy()
        whole[free] = parameters
        return error(whole, signals)

    return replace(
        effect,
        id=f"{effect.id}@{moment[moment != 0.0][0]:.3f}",
        parameters=tuple(effect.parameters[i] for i in free),
        imu_error=held,
        moments=None,
    )


def name_of(effect_id: str) -> str:
    """The catalogue's id of an effect that may be held at a moment."""
    return effect_id.split("@")[0]
