"""Candidates of a search with a name (effects, steps at moments), and their scan."""

from __future__ import annotations

import math
from collections.abc import Sequence, Set

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.case import applicable, frozen_at, name_of
from handcal.estimate.evidence import ReducedPass
from handcal.estimate.model import Fitted, Model
from handcal.estimate.scan import grounds, scan
from handcal.model_score import MOMENTS, prior
from handcal.search.jumps import sudden
from handcal.search.space import Space, space
from handcal.types import Array

# Log odds of a candidate that must not be chosen.
REFUSED = -1e6


def candidates(
    parts: Sequence[Fitted], present: Sequence[Effect], done: ReducedPass
) -> list[Effect]:
    """Effects with parameters that at least one recording could show.

    A step is a candidate at moments on a grid (near its present moment, if the model has it) and at
    the least expected readings. done: a pass over the first recording's fit.
    """
    out: list[Effect] = []
    cases = [f.case for f in parts]
    t = cases[0].recording.imu.t
    for effect in catalogue().values():
        if effect.process is not None or effect.outliers:
            continue
        if not any(applicable(c, effect) for c in cases):
            continue
        if effect.moments is None:
            out.append(effect)
        elif len(cases) == 1:
            grid = effect.moments(t)
            grid = grid[:: max(1, math.ceil(len(grid) / MOMENTS))]
            grid = _near(effect, grid, present)
            if effect.acts_on:
                grid = _with(grid, sudden(parts[0], effect.acts_on, done))
            out += [frozen_at(effect, m) for m in grid]
    return out


def _near(effect: Effect, grid: Array, present: Sequence[Effect]) -> Array:
    """The grid of moments, or a finer one about the moment of a step in the model."""
    for e in present:
        if name_of(e.id) == effect.id:
            at, column = float(e.id.split("@")[1]), int(np.flatnonzero(grid[0])[0])
            step = abs(grid[1, column] - grid[0, column]) if len(grid) > 1 else 1.0
            fine = np.zeros((2 * 8 + 1, grid.shape[1]))
            # (first half a grid step to each side, then a tenth; the present moment stays on it)
            width = step * (0.5 if _on(grid[:, column], at) else 0.1)
            fine[:, column] = at + np.linspace(-width, width, len(fine))
            return fine
    return grid


def _with(grid: Array, at: Array) -> Array:
    """The grid (k, p) with further moments (m,), sorted."""
    column = int(np.flatnonzero(grid[0])[0])
    more = np.zeros((len(at), grid.shape[1]))
    more[:, column] = at
    out = np.vstack([grid, more[[not _on(grid[:, column], x) for x in at]]])
    return out[np.argsort(out[:, column])]


def _on(grid: Array, at: float) -> bool:
    return bool(np.min(np.abs(grid - at)) < 2e-3)


def scanned_about(model: Model, refused: Set[str] = frozenset()) -> Space:
    """The scan of all candidates about a model; refused: names at odds that rule them out."""
    own = {e.id: e for e in model.effects}
    cases = [f.case for f in model.parts]
    about = grounds(model)
    on_trial = candidates(model.parts, model.effects, about[0].done)
    options = [own.get(e.id, e) for e in on_trial]
    have = {e.id for e in options}
    options += [e for e in model.effects if e.id not in have and e.process is None]
    odds = {e.id: prior(e, cases) for e in options}
    odds |= {e.id: REFUSED for e in options if name_of(e.id) in refused}
    odds |= {e.id: -REFUSED for e in options if e.common and e.id in own}
    return space(scan(model, options, about), options, odds)
