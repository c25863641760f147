"""How far a result is to be trusted, and why, wherever it is handed on: "good", "doubtful" (usable,
with reasons to look twice) or "none" (refused, unless it is asked for all the same)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from handcal.types import HandcalError, InputError

GOOD, DOUBTFUL, NONE = LEVELS = ("good", "doubtful", "none")


@dataclass(frozen=True)
class Trust:
    """level: one of ``LEVELS``; reasons: sentences, none where it is good."""

    level: str = GOOD
    reasons: tuple[str, ...] = ()


def judged(against: Iterable[str], doubts: Iterable[str]) -> Trust:
    """The trust that sentences leave: none where any speaks against the result as a whole."""
    against = tuple(against)
    reasons = tuple(dict.fromkeys((*against, *doubts)))
    return Trust(NONE if against else DOUBTFUL if reasons else GOOD, reasons)


def together(several: Iterable[Trust]) -> Trust:
    """The trust of results that stand in one document: the least, with all reasons."""
    several = tuple(several)
    level = max((t.level for t in several), key=LEVELS.index, default=GOOD)
    return Trust(level, tuple(dict.fromkeys(r for t in several for r in t.reasons)))


def json_of(trust: Trust) -> dict[str, Any]:
    """``trust`` and ``trust_reasons``, as the contract has them."""
    return {"trust": trust.level, "trust_reasons": list(trust.reasons)}


def of_document(name: str, document: Mapping[str, Any]) -> Trust:
    """What a result's JSON says of itself; an older one says nothing, which counts as good. name:
    of the file. Errors: InputError."""
    level, reasons = document.get("trust", GOOD), document.get("trust_reasons", [])
    listed = isinstance(reasons, list) and all(isinstance(r, str) for r in reasons)
    if level not in LEVELS or not listed:
        raise InputError(
            f"{name} is damaged: its trust must be {' or '.join(LEVELS)}, with a "
            "list of reasons. Make it again."
        )
    return Trust(level, tuple(reasons))


def check(name: str, trust: Trust, anyway: bool) -> None:
    """Errors: HandcalError where nothing is to be trusted, unless that is wanted anyway. name: of
    the result."""
    if trust.level == NONE and not anyway:
        why = " ".join(trust.reasons) or "It does not say why."
        raise HandcalError(
            f"{name} is not to be trusted (trust: none), so it is not used. {why} Use it anyway "
            "with --anyway."
        )


def said(name: str, trust: Trust) -> tuple[str, ...]:
    """The reasons in sentences that stand alone. name: of the result."""
    level = "not to be trusted" if trust.level == NONE else trust.level
    if trust.level != GOOD and not trust.reasons:
        return (f"{name} is {level}; it does not say why.",)
    return tuple(f"{name} is {level}: {reason}" for reason in trust.reasons)
