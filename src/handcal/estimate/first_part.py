"""The first part of long recordings: a fit as it is there, for a look that need not be exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handcal.estimate.case import Case, problem_with
from handcal.estimate.linear import About
from handcal.estimate.model import Fitted, Model
from handcal.estimate.transfer import transferred
from handcal.types import Recording

# Of all turning the first part has so much, and it is no shorter than that, s: what an error does
# to a recording it does to a fourth of its turning too.
SHARE, LEAST_S = 0.25, 30.0
# Where that is more than this share of a recording, its first part says little of it (one that is
# moved fast only in its second half), and spares little.
MOST = 0.45


def first_part(model: Model) -> Model | None:
    """The model about the first part of its recordings, nothing fitted; None where that is most
    of one."""
    ends = [_end(f.case.recording) for f in model.parts]
    if any(end is None for end in ends):
        return None
    parts = zip(model.parts, ends, strict=True)
    return replace(model, parts=tuple(_until(f, end) for f, end in parts if end is not None))


def _end(recording: Recording) -> float | None:
    """When the first part of a recording ends, s; None where that is most of it."""
    imu = recording.imu
    begin, most = float(imu.t[0]), MOST * recording.duration_s
    if most < LEAST_S:
        return None
    turned = np.cumsum(np.linalg.norm(imu.gyro[1:], axis=1) * np.diff(imu.t))
    at = float(imu.t[1 + int(np.searchsorted(turned, SHARE * turned[-1]))])
    lasts = max(at - begin, LEAST_S)
    return begin + lasts if lasts <= most else None


def _until(f: Fitted, t: float) -> Fitted:
    """The fit of a recording up to time t, s, about the same trajectory."""
    case = _cut(f.case, t)
    problem = problem_with(case, f.problem.effects)
    way = transferred(f.trajectory, f.about, problem)
    return Fitted(case, About(problem, f.about.start, way), f.levels)


def _cut(case: Case, t: float) -> Case:
    """A case up to time t, s. (It begins where the whole does: what is a function of time stays
    what it is, and so does what is known of the first state.)"""
    imu, streams = case.recording.imu, case.recording.streams
    n = int(np.searchsorted(imu.t, t, side="right"))
    imu = replace(imu, t=imu.t[:n], gyro=imu.gyro[:n], accel=imu.accel[:n], valid=imu.valid[:n])
    streams = {
        name: replace(s, t=s.t[s.t <= t], value=s.value[s.t <= t]) for name, s in streams.items()
    }
    observed = []
    for o, rows, constants in case.observed:
        own = rows.t <= t
        alpha = None if rows.alpha is None else rows.alpha[:n]
        moved = None if rows.moved is None else rows.moved[own]
        rows = replace(rows, t=rows.t[own], z=rows.z[own], alpha=alpha, moved=moved)
        observed.append((o, rows, constants))
    recording = replace(case.recording, imu=imu, streams=streams)
    return replace(case, recording=recording, observed=tuple(observed))
