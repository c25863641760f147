"""Looks at noise effects: the evidence of each at a few levels, before any is fitted."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial

from handcal.effects import Effect, catalogue
from handcal.estimate.case import applicable
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Fitted
from handcal.estimate.noise_look import as_they_are, with_noise
from handcal.estimate.transfer import fit_of
from handcal.laws import with_motion
from handcal.model_score import prior


def all_noise(besides: Collection[str] = ()) -> list[Effect]:
    """Noise effects of the catalogue, and motion-dependent errors, without those of these ids."""
    every = (*catalogue().values(), *with_motion.effects())
    return [e for e in every if e.process is not None and e.id not in besides]


@dataclass(frozen=True)
class Look:
    """A model with one more noise effect (the last) at the best of a few levels, all else kept;
    gain: of evidence over the model without it, nats."""

    effects: tuple[Effect, ...]
    parts: tuple[Fitted, ...]
    gain: float


def looks_of(
    parts: Sequence[Fitted], effects: Sequence[Effect], noise: Sequence[Effect], most: int
) -> list[Look]:
    """The ``most`` noise effects with the highest scores, each added to ``effects``, best first.
    Only those that the recordings could show are evaluated."""
    plain = [fit_of(f, effects) for f in parts]
    here = as_they_are(plain)

    def look(e: Effect) -> Look:
        wide, there = with_noise(plain, effects, e)
        return Look((*effects, e), wide, there - here)

    def scored(found: Look) -> float:
        return found.gain + prior(found.effects[-1], [f.case for f in parts])

    shown = [e for e in noise if any(applicable(f.case, e) for f in parts)]
    best: list[Look] = []
    for found in in_parallel(partial(look, e) for e in shown):
        best = sorted([*best, found], key=scored, reverse=True)[:most]
    return best
