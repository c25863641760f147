"""One problem solved: filtered, smoothed and relinearised, with noise levels found by evidence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from handcal.estimate import noise_levels, smoother
from handcal.estimate.evidence import reduce
from handcal.estimate.filter import empty_track, run_compiled
from handcal.estimate.linear import Linear, linearise_about
from handcal.estimate.observed import first_state
from handcal.estimate.problem import Problem, noise_arrays
from handcal.estimate.start import Start
from handcal.estimate.trajectory import epochs, trajectory_of


@dataclass(frozen=True)
class Solution:
    """A settled fit: the linearised problem, its last forward pass and its noise levels."""

    linear: Linear
    forward: smoother.Pass
    levels: Mapping[str, float]


def solve(problem: Problem, start: Start, fixed: Mapping[str, float]) -> Solution:
    """The fit with noise levels that are not ``fixed`` found anew."""
    levels = noise_levels.initial_levels(problem)
    levels |= {k: v for k, v in fixed.items() if k in levels}
    free = tuple(lv.name for lv in problem.levels if lv.name not in fixed)
    track = empty_track(problem, epochs(problem))
    state = run_compiled(
        problem, noise_arrays(problem, levels), first_state(problem, start, levels), track
    )
    nominal = trajectory_of(problem, track, state.bg, state.ba, state.extras)
    linear, _, _ = smoother.relinearise(linearise_about(problem, start, nominal), levels)
    for _ in range(2 if free else 0):
        new, _ = noise_levels.estimate(reduce(linear), levels, free)
        change = max(abs(math.log(new[n] / levels[n])) for n in free)
        levels = new
        linear, _, _ = smoother.relinearise(linear, levels)
        if change < 0.02:
            break
    return Solution(linear, smoother.forward(linear, levels), levels)
