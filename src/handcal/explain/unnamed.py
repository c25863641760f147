"""Terms that nobody named: the best of hundreds beside a model, and courses fitted again."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from handcal.effects import Effect, Signals
from handcal.estimate.beside import side_by_side
from handcal.estimate.fit import Fitted, Model, fitted, prior_root, scan
from handcal.estimate.quadratic import Quadratic
from handcal.explain import shapes, terms
from handcal.explain.score import TERM_PRIOR, prior
from handcal.explain.search import gains, space
from handcal.signals import of_recording
from handcal.types import Array, IntArray


@dataclass(frozen=True)
class Term:
    """An unnamed term, and the nats that it gains at the likelihood's full worth; basis: the
    spline of which it is a course, if it is one."""

    effect: Effect
    gain: float
    basis: shapes.Basis | None


def reshaped(model: Model, unnamed: list[Term], shaped: set[str]) -> Model | None:
    """The model with a course over time or direction that fits better than the one it has, which
    was chosen when less was known; ``unnamed`` is changed with it."""
    for i, term in enumerate(unnamed):
        old = term.effect
        if term.basis is None or old.id not in model.ids or old.id in shaped:
            continue
        shaped.add(old.id)
        rest = [e for e in model.effects if e is not old and e.process is None]
        new, _ = shapes.best(term.basis, *_beside(model, rest, term.basis))
        if new.id == old.id:
            continue
        tried = fitted(model.parts, [new if e is old else e for e in model.effects])
        if tried.log_evidence > model.log_evidence:
            unnamed[i] = replace(term, effect=new)
            return tried
    return None


def _beside(
    model: Model, known: Sequence[Effect], basis: shapes.Basis
) -> tuple[Quadratic, IntArray, Array | None]:
    """What ``shapes.best`` asks for: the quadratic with the basis, and the known effects in it."""
    wide = scan(model, [basis.effect])
    ids = {e.id for e in known}
    index: IntArray = np.array([i for i, n in enumerate(wide.names) if n[0] in ids], dtype=np.int64)
    return wide, index, prior_root(wide, known, index)


def best_term(model: Model, *, imu: bool = True, refused: Collection[str] = ()) -> Term | None:
    """The unnamed term that gains most over the model, if one gains enough. imu: False to look
    for one of the heading alone; refused: formulas that no fit holds with."""
    f = model.parts[0]
    signals, recording = signals_of(f), f.case.recording
    enough = -TERM_PRIOR + math.log(2.0)
    found: Term | None = None
    chunks = [
        (terms.imu_terms(signals, c), [shapes.imu_basis(c, recording.duration_s)])
        for c in range(6 if imu else 0)
    ]
    if "heading" in f.case.kinds:
        chunks.append((terms.heading_terms(recording), shapes.heading_bases(recording.duration_s)))
    tops = side_by_side(partial(_top, model, *chunk, refused) for chunk in chunks)
    for top, worth in tops:
        full = top.gain / worth
        if top.gain > enough and (found is None or full > found.gain):
            found = replace(top, gain=full)
    return found


def _top(
    model: Model, chunk: Sequence[Effect], bases: Sequence[shapes.Basis], refused: Collection[str]
) -> tuple[Term, float]:
    """The term of these, or the course over one of these bases, that gains most over the model;
    and what evidence counts for."""
    own = [e for e in model.effects if e.process is None]
    here = frozenset(e.id for e in own)
    options = [*own, *(e for e in chunk if e.id not in here)]
    cases = [f.case for f in model.parts]
    odds = {e.id: prior(e, cases) for e in options}
    wide = space(scan(model, [*options, *(b.effect for b in bases)]), options, odds)
    q, gained = wide.quadratic, gains(wide, here)
    known = np.concatenate([np.zeros(0, dtype=np.int64), *(wide.where[e.id] for e in own)])
    ends = [Term(e, gained[e.id], None) for e in options if e.id not in here]
    for b in bases:
        ends.append(Term(*shapes.best(b, q, known, prior_root(q, own, known)), b))
    ends = [end for end in ends if end.effect.id not in refused]
    return max(ends, key=lambda end: end.gain), q.worth


def signals_of(f: Fitted) -> Signals:
    """The best estimate of rate and force at the IMU's samples, for scaling terms."""
    imu, nominal = f.case.recording.imu, f.linear.trajectory
    read = np.hstack([imu.gyro - nominal.bg, imu.accel - nominal.ba])
    return of_recording(f.case.recording, read=read)
