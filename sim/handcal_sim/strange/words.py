"""Drivers as an explanation calls them, in the simulator's own words, so as to be compared.

Two drivers count as the same where one is a function of the other at each moment in a hand that
stays where it is, or is its past: size, square and memory are the response's. What points up is
what the force shows; what points north is told by heading and tilt.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from handcal_sim.strange.law import bare, on_axes
from handcal_sim.strangers import AXES

# As somebody else may say it: pattern and what it is here. `pitch of x` is how far body x points
# up.
_SAME = (
    (r"(?:rate|turning|speed|size of omega|size of the rate)", "|omega|"),
    (r"(?:force|size of f|size of the force)", "|f|"),
    (r"(?:past|memory|lag|lagged|history|rate of change|rate|change|size) of (.+)", r"\1"),
    (r"pitch of ([xyz])", r"up_\1"),
    (r"(?:gyro|rate|w)_([xyz])", r"omega_\1"),
    (r"(?:accel|force)_([xyz])", r"f_\1"),
    (r"(?:yaw|psi)", "heading"),
    (r"(?:temperature|temp|warm)", "T"),
    (r"time", "t"),
    (r"time since (?:a|the last) turn", "|omega|"),
    (r"(?:heading rate|yaw rate|rate about (?:the )?vertical|turn)", "turn"),
    (r"(?:roll|pitch|up)", "tilt"),
)  # fmt: skip


def said(driver: str) -> str:
    """The driver in the simulator's words, with what is said of its past; else as it is."""
    now = re.sub("^past (of )?", "", driver)
    past = now != driver
    for pattern, here in _SAME:
        if re.fullmatch(pattern, now):
            now = re.sub(f"^{pattern}$", here, now)
    return f"past {now}" if past else now


def core(driver: str) -> str:
    """What stands for all drivers that count as the same: |omega_x| and past omega_x as omega_x,
    up_x as f_x."""
    now = bare(said(driver))
    inner = re.fullmatch(r"\|(\w+_[xyz])\|", now)
    now = inner.group(1) if inner else now
    return re.sub(r"^up_([xyz])$", r"f_\1", now)


def same(found: Iterable[str], true: Iterable[str], channel: str = "") -> bool:
    """Whether drivers that were found are those of a law: no fewer and no more; channel: on which
    they were found, if they may be called after its axis (omega_i)."""
    f = {core(of_channel(driver, channel)) for driver in found}
    true = tuple(true)
    t = {core(driver) for driver in true}
    changes = [(c, frozenset({_CHANGES[c]})) for c in _with_past(true) if c in _CHANGES]
    return any(f == _put(t, old, new) for old, new in (*_EQUAL, *changes))


def of_channel(driver: str, channel: str) -> str:
    """The driver with its letters as axes: omega_i of accel_y is omega_y."""
    axis = AXES.find(channel[-1:]) if channel else -1
    return on_axes(driver, axis) if axis >= 0 else driver


def _with_past(drivers: Iterable[str]) -> set[str]:
    return {core(driver) for driver in drivers if driver != bare(driver)}


# How fast something changes: of a law to which its past counts, that describes it too.
_CHANGES = {
    **{f"omega_{a}": f"alpha_{a}" for a in AXES},
    **{f"f_{a}": f"jerk_{a}" for a in AXES},
    "heading": "turn",
}

# What else describes a driver completely: old, and what may stand for it.
_EQUAL: tuple[tuple[str, frozenset[str]], ...] = (
    ("", frozenset()),
    ("|omega|", frozenset({"omega_x", "omega_y", "omega_z"})),
    ("|f|", frozenset({"f_x", "f_y", "f_z"})),
    ("tilt", frozenset({"f_z"})),
    *((f"north_{a}", frozenset({"heading", "tilt"})) for a in "xyz"),
    *((f"north_{a}", frozenset({"heading"})) for a in "xyz"),
    *((f"f_{a}", frozenset({"tilt"})) for a in "xyz"),
    *((f"north_{a}", frozenset({"heading", f"f_{a}"})) for a in "xyz"),
    ("turn", frozenset({"heading"})),
)


def _put(drivers: set[str], old: str, new: frozenset[str]) -> set[str]:
    return (drivers - {old}) | new if old in drivers else drivers
