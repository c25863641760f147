"""Effects that act on a heading and on a magnetometer are called after the one that was recorded;
their ids stay."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from handcal.effects import catalogue
from handcal.estimate.case import Case
from handcal.explanation import Hypothesis, Missing


def for_streams(
    missing: Iterable[Missing], hypotheses: Iterable[Hypothesis], cases: Sequence[Case]
) -> tuple[tuple[Missing, ...], tuple[Hypothesis, ...]]:
    """With titles and stories for these recordings."""
    return (
        tuple(of_missing(m, cases) for m in missing),
        tuple(of_hypothesis(h, cases) for h in hypotheses),
    )


def of_missing(m: Missing, cases: Sequence[Case]) -> Missing:
    """With title and story for these recordings."""
    if not _renamed(m.effect, cases):
        return m
    return replace(m, title=_said(m.title), story=_said(m.story))


def of_hypothesis(h: Hypothesis, cases: Sequence[Case]) -> Hypothesis:
    """With the title for these recordings."""
    return replace(h, title=_said(h.title)) if _renamed(h.effect, cases) else h


def _renamed(effect: str, cases: Sequence[Case]) -> bool:
    known = catalogue().get(effect)
    kinds = {kind for case in cases for kind in case.kinds}
    both = known is not None and {"heading", "magnetometer"} <= known.acts_on
    return both and "magnetometer" in kinds and "heading" not in kinds


def _said(text: str) -> str:
    return text.replace("Heading", "Magnetometer").replace("heading", "magnetometer")
