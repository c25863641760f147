"""What the signs in a formula mean, for those who read one for the first time."""

from __future__ import annotations

import inspect
import re
from collections.abc import Sequence

from handcal.laws.operators import OPERATORS

# A sign, as it is found in a formula, and its meaning.
_SIGNS = (
    (r"omega", "omega: the angular rate, rad/s (|omega|: its magnitude)"),
    (r"\bf_|\|f\|", "f: the specific force, m/s² (|f|: its magnitude)"),
    (r"alpha", "alpha: the angular acceleration, rad/s²"),
    (r"jerk", "jerk: how fast the specific force changes, m/s³"),
    (r"\bT\b", "T: the temperature, °C"),
    (r"\byaw\b", "yaw: the heading, rad, counter-clockwise from where it reads zero"),
    (r"\btilt\b", "tilt: the angle of body z from the vertical, rad"),
    (r"\bpitch of", "pitch of an axis: its angle above the horizontal, rad"),
    (r"\bnorth_", "north: the part of an axis that points to where the heading reads zero"),
    (r"\bt\b", "t: the time, s"),
    (r"_[ijk]\b", "i: each axis in turn (j and k: the two that follow it, x after z)"),
    (r"\be\(", "e( ): an error that varies with time or attitude"),
    (r"\bg(_i)?\(", "g( ): the curve that is drawn"),
    (r"\bclip\(", "clip(x, a, b): x limited to the range from a to b"),
)


def meanings(formulas: Sequence[str]) -> str:
    """What is not plain arithmetic in these formulas, a phrase each; empty of none."""
    if not formulas:
        return ""
    laws = " ; ".join(formula.partition(" += ")[2] for formula in formulas)
    out = ["+=: is added to the reading"]
    out += [meaning for sign, meaning in _SIGNS if re.search(sign, laws)]
    words = {o.text.lstrip("(").partition("(")[0]: o for o in OPERATORS.values()}
    for word, operator in words.items():
        if re.search(rf"\b{word}\([^()]*\) of ", laws):
            told = " ".join((inspect.getdoc(operator.of) or "").replace(" (n,)", "").split())
            out.append(f"{word}( ) of x: {told[:1].lower()}{told[1:].rstrip('.')}")
    return f"In SI units: {'; '.join(out)}."
