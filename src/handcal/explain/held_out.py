"""Scores on data that the fit has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from handcal.estimate import noise_levels
from handcal.estimate.baseline import always, started
from handcal.estimate.case import Case
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import EXCESS, fitted, known_of, own_levels
from handcal.estimate.linear import Linear
from handcal.estimate.model import Fitted, Model
from handcal.explain.locate import at_levels, residual_rms
from handcal.explanation import HeldOut

# Share of a recording that is seen before the rest is predicted.
EARLY = 0.6


def later_blocks(base: Model, model: Model) -> HeldOut:
    """Predict the last two fifths of each recording from the first three, noise levels included."""
    scores = []
    for m in (base, model):
        score = 0.0
        for f in m.parts:
            early = reduce(early_part(f.linear))
            names = [lv.name for lv in f.problem.levels if lv.name not in f.case.fixed]
            levels, _ = noise_levels.estimate(
                early, f.levels, names, excess=EXCESS, known=f.curvature
            )
            whole = reduced_pass(reduce(f.linear), levels).log_evidence
            score += whole - reduced_pass(early, levels).log_evidence
        scores.append(score + sum(f.case.constant for f in m.parts) * (1 - EARLY))
    before = _residuals(at_same_noise(base.parts, model.parts))
    return HeldOut("later blocks", scores[0], scores[1], before, _residuals(model.parts))


def early_part(linear: Linear) -> Linear:
    """What is seen before the rest is predicted."""
    return noise_levels.until(linear, linear.t[0] + EARLY * (linear.t[-1] - linear.t[0]))


def at_same_noise(before: Sequence[Fitted], after: Sequence[Fitted]) -> list[Fitted]:
    """Fits of the baseline at the final model's noise levels: with its own, it would call what
    it lacks sway, and its residuals would look small."""
    return [
        fitted([at_levels(b, a.levels)], b.problem.effects, noise_rounds=0).parts[0]
        for b, a in zip(before, after, strict=True)
    ]


def _residuals(fits: Sequence[Fitted]) -> dict[str, float]:
    parts = [residual_rms(f) for f in fits]
    return {c: float(np.sqrt(np.mean([p[c] ** 2 for p in parts if c in p]))) for c in parts[0]}


def other_files(cases: Sequence[Case], model: Model) -> tuple[HeldOut, Model]:
    """Score recordings that took no part: with the effects as found, against none at all; and the
    fit with them."""
    known = known_of(model)
    # a step belongs to the recording in which it happened
    effects = [e for e in model.effects if "@" not in e.id]
    before, after = [], []
    for case in cases:
        known_of_all = always([case])
        start = started(case, known_of_all)
        before.append(fitted([start], known_of_all))
        begin = replace(start, levels={**start.levels, **own_levels(model.parts[0])})
        after.append(fitted([begin], effects, known=known))
    names = ", ".join(str(c.recording.path) for c in cases)
    scores = HeldOut(
        names,
        sum(m.log_evidence for m in before),
        sum(m.log_evidence for m in after),
        _residuals(
            [f for b, a in zip(before, after, strict=True) for f in at_same_noise(b.parts, a.parts)]
        ),
        _residuals([f for m in after for f in m.parts]),
    )
    parts = tuple(f for m in after for f in m.parts)
    return scores, replace(model, effects=tuple(effects), parts=parts)
