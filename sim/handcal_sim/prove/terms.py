"""Whether a formula that was found speaks of the same signals as the one that was injected."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

_SAME = {"yaw": "heading", "psi": "heading", "temperature": "T", "temp": "T", "time": "t",
         "gyro": "omega", "w": "omega", "accel": "f", "force": "f"}  # fmt: skip
_SIGNALS = re.compile(r"(?:omega|alpha|f)_[xyz]|heading|T|t")


def signals_of(text: str) -> set[str]:
    """The measured signals in a formula, whatever they are called."""
    found = set()
    for word in re.findall(r"[A-Za-z]+(?:_[xyz])?(?![A-Za-z_])", text):
        head, _, axis = word.partition("_")
        name = _SAME.get(head, head) + (f"_{axis}" if axis else "")
        if _SIGNALS.fullmatch(name):
            found.add(name)
    return found


def formula_fits(formula: str, stranger: Mapping[str, Any]) -> tuple[bool, bool]:
    """Whether the channel is right, and whether its signals are all there besides.

    A stranger without signals (no product of any would describe it) asks for the channel.
    """
    left, _, right = formula.partition("+=")
    channel = left.strip() == stranger["channel"]
    return channel, channel and set(stranger["signals"]) <= signals_of(right)
