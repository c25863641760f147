"""The leading explanation of what has been recorded so far, in seconds: for somebody who is still
turning the device. Names, steps and noise are selected on the one matrix; laws without a name,
other starts and other hands are left to ``explain``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from handcal.estimate.baseline import baseline, dense
from handcal.estimate.case import case_of
from handcal.explain.assembled import learnt_of
from handcal.explain.naming import entries_of, likely
from handcal.explain.next_motion import next_motions
from handcal.explanation import Missing, NextMotion
from handcal.motions import Motion
from handcal.search.beyond_columns import gains_of_noise
from handcal.search.budget import Budget
from handcal.search.candidates import scanned_about
from handcal.search.climb import Climb, Made, climbed
from handcal.search.multistart import Found
from handcal.types import Prior, Recording


@dataclass(frozen=True)
class Leading:
    """missing: effects that are likelier than not, the most evidence first, each with those that
    could stand in its place; next: the motions that separate these, the best first."""

    missing: tuple[Missing, ...]
    next: tuple[NextMotion, ...]


def leading(
    recording: Recording, before: Prior | None, motions: Sequence[Motion], budget: Budget
) -> Leading:
    """The leading explanation of a recording. before: prior of the device; motions: that may be
    asked for. Raises HandcalError if no fit converges."""
    base = dense(baseline([case_of(recording, before=before)])).bare
    climb = Climb(frozenset(base.ids), frozenset(), budget, Made(), named=True)
    model = climbed(climb, base, lambda _, __: None)
    where = scanned_about(model)
    noise = gains_of_noise(model, climb.kept, where.quadratic.worth)
    found = Found(model.bare, where, {}, noise)
    entries, unsure = entries_of(found, model.chosen, learnt_of(found), None)
    missing = sorted(likely(entries, {}), key=lambda m: -m.log_evidence_gain)
    verdict = "cannot_tell" if unsure else "explained"
    separated = [m for m in next_motions(found, missing, (), verdict, motions) if m.separates]
    return Leading(tuple(missing), tuple(separated))
