"""What is in every model anyway (a magnetometer's hard iron), and so is never missing from one: how
it is told beside what is."""

from __future__ import annotations

from dataclasses import replace

from handcal.effects import catalogue
from handcal.explanation import Explanation, Mismatch, Missing
from handcal.show import words
from handcal.show.explanation.words import (
    is_always,
    members,
    nats,
    one_model,
    percent,
    the,
)
from handcal.show.words import listed


def parted(e: Explanation) -> tuple[Explanation, list[Missing]]:
    """The explanation with what was added to the baseline alone, and what is in the baseline."""
    added = tuple(m for m in e.missing if not is_always(m))
    return replace(e, missing=added), [m for m in e.missing if is_always(m)]


def nothing_added(e: Explanation) -> bool:
    """Whether all that is told is in the baseline, so that baseline and final model are one."""
    return bool(e.missing) and one_model(e)


def told_mismatch(e: Explanation) -> tuple[Mismatch, ...]:
    """Where the baseline does not fit; nowhere where it is the final model."""
    return () if nothing_added(e) else e.mismatch


def every_model(m: Missing) -> str:
    """ "every model of a magnetometer"."""
    kinds = [words.kind_title(k) for k in sorted(catalogue()[m.effect].acts_on)]
    return f"every model of a {kinds[0]}" if kinds else "every model"


def sentence(m: Missing, e: Explanation) -> str:
    """That it shows, and what a model without it would cost."""
    title = the(listed(members(m, e), "or"))
    return (
        f"{title[:1].upper()}{title[1:]} shows (probability {percent(m.probability)}): it is in "
        f"{every_model(m)}, and leaving it out would cost {nats(m.log_evidence_gain)}."
    )
