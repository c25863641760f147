"""Scan of noise effects: the evidence of each at a few levels, before any is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from handcal.effects import Effect, catalogue
from handcal.estimate.case import applicable
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import fitted
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Fitted, Model
from handcal.estimate.noise_look import as_they_are, with_noise
from handcal.estimate.transfer import fit_of, moved_to
from handcal.laws import with_motion
from handcal.model_score import better, prior

# Gain of a noise effect at its best level in the scan from which it is fitted, nats.
LOOK = 3.0


def all_noise() -> list[Effect]:
    """Noise effects of the catalogue, and motion-dependent errors."""
    return [e for e in (*catalogue().values(), *with_motion.effects()) if e.process is not None]


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


def of_looks(looks: Sequence[Look]) -> list[tuple[Model, Effect]]:
    """Fits of the looks that gain more than ``LOOK``, with their noise effects."""
    some = [look for look in looks if look.gain > LOOK]
    fits = in_parallel(partial(fitted, look.parts, look.effects) for look in some)
    return [(m, look.effects[-1]) for m, look in zip(fits, some, strict=True)]


def on_fewer_axes(model: Model, added: Effect, worth: float) -> tuple[Model, Effect]:
    """The model with its motion-dependent error on fewer axes, if that is likelier, and the
    error."""
    if not with_motion.is_with_motion(added.id):
        return model, added
    rest = [e for e in model.effects if e is not added]
    options = with_motion.fewer(added)
    if not options:
        return model, added
    best = max(options, key=lambda e: _kept_at(model, rest, e, added))
    tried = fitted(model.parts, [*rest, best])
    return (tried, best) if better(tried, model, worth) > 0.0 else (model, added)


def _kept_at(model: Model, rest: Sequence[Effect], new: Effect, old: Effect) -> float:
    """Log-evidence with ``new`` in place of the noise effect ``old``, at the same levels, all else
    kept."""
    total = 0.0
    for f in model.parts:
        wide = moved_to(f, (*rest, new))
        same = {b.name: f.levels[a.name] for a, b in zip(old.levels, new.levels, strict=True)}
        total += reduced_pass(reduce(wide.linear), {**wide.levels, **same}).log_evidence
    return total
