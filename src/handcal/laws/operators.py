"""What a sensor may do with a signal besides following it: the operators of the vocabulary.

Each makes of a signal x (n,) at times t (n,) another one, with one number (a time, a width, a
frequency). Adding one is adding a row to ``OPERATORS``; the same source is what a law that is
written out brings along.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from handcal.compiled.jit import njit
from handcal.types import Array

# Times of memory, s: from the settling of a filter to that of warm glue.
MEMORIES = (0.4, 1.0, 2.5, 6.0, 15.0)
# And of what overshoots, and comes back to what is there: shorter than most turns.
OVERSHOOTS = (0.4, 1.0, 2.5)
# Of what follows late on one way only, or comes back once.
LATE = (0.3, 1.0, 3.0)
# Frequencies of what swings, Hz: above, a hand does not excite it.
SWINGS = (0.3, 0.6, 1.2, 2.4)
# Widths, as shares of the largest size of a signal: wider than the noise, narrower than the motion.
WIDTHS = (0.03, 0.06, 0.12, 0.25, 0.45)
# How far out a side is taken.
FAR = (0.06, 0.12, 0.25, 0.45, 0.65)
# And of steps, which have to be met to within a fraction of one over the whole range.
STEPS = tuple(0.08 * 1.13**n for n in range(17))
# Digits of a number in a driver's name, which is all that a file has of it: an echo 5 ms off is 1 %
# off where a hand turns the device.
DIGITS = 4
# Faster than that a device turns, rad/s, where something is frozen meanwhile.
FREEZING = (0.3, 0.5, 0.8, 1.2, 1.8)
# How fast what is too slow may follow, of the root mean square slope.
SLEWS = (0.3, 0.7, 1.5)


@njit
def remembered(t: Array, x: Array, tau: float) -> Array:
    """The mean (n,) of what x was, weighed by exp(-age / tau)."""
    out = np.empty(len(x))
    out[0] = x[0]
    for i in range(1, len(x)):
        share = -np.expm1(-(t[i] - t[i - 1]) / tau)
        out[i] = out[i - 1] + share * (x[i] - out[i - 1])
    return out


@njit
def following(t: Array, x: Array, half: float) -> Array:  # noqa: ARG001
    """What follows x with so much play to either side (the operator of which Prandtl and
    Ishlinskii built hysteresis)."""
    out = np.empty(len(x))
    at = x[0]
    for i in range(len(x)):
        at = min(max(at, x[i] - half), x[i] + half)
        out[i] = at
    return out


@njit
def sticking(t: Array, x: Array, loose: float) -> Array:  # noqa: ARG001
    """What stays where it is until x is so far away, and then jumps to it."""
    out = np.empty(len(x))
    at = x[0]
    for i in range(len(x)):
        if abs(x[i] - at) > loose:
            at = x[i]
        out[i] = at
    return out


@njit
def yielding(t: Array, x: Array, width: float) -> Array:  # noqa: ARG001
    """Dry friction that gives way by and by (Dahl): how far it is bent, from -1 to 1."""
    out = np.empty(len(x))
    bent = 0.0
    out[0] = bent
    for i in range(1, len(x)):
        step = (x[i] - x[i - 1]) / width
        sign = 1.0 if step > 0.0 else -1.0
        bent = sign - (sign - bent) * np.exp(-abs(step))
        out[i] = bent
    return out


@njit
def sided(t: Array, x: Array, far: float) -> Array:  # noqa: ARG001
    """The side, -1 or 1, on which x was last so far out; 0 before that."""
    out = np.empty(len(x))
    side = 0.0
    for i in range(len(x)):
        if abs(x[i]) > far:
            side = 1.0 if x[i] > 0.0 else -1.0
        out[i] = side
    return out


@njit
def peaked(t: Array, x: Array, tau: float) -> Array:
    """The largest size of x so far, forgotten in time."""
    out = np.empty(len(x))
    held = 0.0
    for i in range(len(x)):
        if i:
            held *= np.exp(-(t[i] - t[i - 1]) / tau)
        held = max(held, abs(x[i]))
        out[i] = held
    return out


@njit
def falling(t: Array, x: Array, tau: float) -> Array:
    """What rises with x at once, and falls to it in time."""
    out = np.empty(len(x))
    at = x[0]
    for i in range(len(x)):
        if i and x[i] < at:
            at += -np.expm1(-(t[i] - t[i - 1]) / tau) * (x[i] - at)
        else:
            at = x[i]
        out[i] = at
    return out


@njit
def rising(t: Array, x: Array, tau: float) -> Array:
    """What falls with x at once, and rises to it in time."""
    out = np.empty(len(x))
    at = x[0]
    for i in range(len(x)):
        if i and x[i] > at:
            at += -np.expm1(-(t[i] - t[i - 1]) / tau) * (x[i] - at)
        else:
            at = x[i]
        out[i] = at
    return out


@njit
def slewing(t: Array, x: Array, fast: float) -> Array:
    """What follows x no faster than so much a second."""
    out = np.empty(len(x))
    at = x[0]
    for i in range(len(x)):
        if i:
            most = fast * (t[i] - t[i - 1])
            at += min(max(x[i] - at, -most), most)
        out[i] = at
    return out


@njit
def swinging(t: Array, x: Array, hz: float) -> Array:
    """What hangs on a spring, hardly damped (a tenth), and is carried along by x."""
    out = np.empty(len(x))
    w, damping = 2.0 * np.pi * hz, 0.1
    a, wd = damping * w, w * np.sqrt(1.0 - damping**2)
    out[0], speed = x[0], 0.0
    for i in range(1, len(x)):
        dt, held = t[i] - t[i - 1], 0.5 * (x[i - 1] + x[i])
        fade, c, s = np.exp(-a * dt), np.cos(wd * dt), np.sin(wd * dt) / wd
        away = out[i - 1] - held
        out[i] = held + fade * ((c + a * s) * away + s * speed)
        speed = fade * ((c - a * s) * speed - w * w * s * away)
    return out


@njit
def swaying(t: Array, x: Array, hz: float) -> Array:
    """What hangs on a spring, damped (three tenths), and is carried along by x."""
    out = np.empty(len(x))
    w, damping = 2.0 * np.pi * hz, 0.3
    a, wd = damping * w, w * np.sqrt(1.0 - damping**2)
    out[0], speed = x[0], 0.0
    for i in range(1, len(x)):
        dt, held = t[i] - t[i - 1], 0.5 * (x[i - 1] + x[i])
        fade, c, s = np.exp(-a * dt), np.cos(wd * dt), np.sin(wd * dt) / wd
        away = out[i - 1] - held
        out[i] = held + fade * ((c + a * s) * away + s * speed)
        speed = fade * ((c - a * s) * speed - w * w * s * away)
    return out


@njit
def earlier(t: Array, x: Array, late: float) -> Array:
    """What x was so long ago."""
    return np.interp(t - late, t, x)


def smoothed(t: Array, x: Array, tau: float) -> Array:
    """The mean (n,) of what x was and will be, weighed by exp(-age / tau) on either side."""
    since = np.ascontiguousarray(-t[::-1])
    return remembered(since, np.ascontiguousarray(remembered(t, x, tau)[::-1]), tau)[::-1]


@njit
def stepped(t: Array, x: Array, step: float) -> Array:  # noqa: ARG001
    """x to the nearest whole number of steps."""
    return step * np.floor(x / step + 0.5)


@njit
def frozen(t: Array, x: Array, slow: float, turning: Array) -> Array:  # noqa: ARG001
    """What x was when the device last turned no faster than so much, while it turns faster."""
    out = np.empty(len(x))
    at = x[0]
    for i in range(len(x)):
        if turning[i] <= slow:
            at = x[i]
        out[i] = at
    return out


@dataclass(frozen=True)
class Operator:
    """text: how a driver with it is called, of the signal {x}, its unit {u} and the number {n};
    of(t, x, number): what it makes of a signal; turning: whether it takes how fast the device
    turns (n,), rad/s, as well; less: what a driver has is that, less the signal;
    numbers, share: to begin with, and of what (``Scale``): 1, or the signal's size or slope; power:
    of the signal's unit that of the driver."""

    text: str
    of: Callable[..., Array]
    numbers: tuple[float, ...]
    share: str = "1"
    less: bool = True
    power: int = 1
    positive: bool = False
    turning: bool = False

    def values(self, t: Array, x: Array, number: float, turns: Array) -> Array:
        """What a driver is (n,); turns (n,): how fast the device turns, rad/s."""
        x = np.ascontiguousarray(x)
        made = self.of(t, x, number, turns) if self.turning else self.of(t, x, number)
        return made - x if self.less else made

    def begun(self, t: Array, x: Array) -> list[float]:
        """Numbers to begin with, for a signal (n, ...)."""
        unit = 1.0
        if self.share == "size":
            unit = float(np.quantile(np.abs(x), 0.999))
        if self.share == "slope":
            unit = float(np.sqrt(np.mean(np.gradient(x, t, axis=0) ** 2)))
        return [share * unit for share in self.numbers]


def _less(word: str, unit: str) -> str:
    return f"({word}({{n}} {unit}) of {{x}} - {{x}})"


def _of(word: str, unit: str) -> str:
    return f"({word}({{n}} {unit}) of {{x}})"


OPERATORS: Mapping[str, Operator] = {
    "memory": Operator(_of("memory", "s"), remembered, MEMORIES, less=False),
    "lag": Operator(_less("memory", "s"), remembered, OVERSHOOTS),
    "play": Operator(_less("play", "{u}"), following, WIDTHS, "size", positive=True),
    "stick": Operator(_less("stick", "{u}"), sticking, WIDTHS, "size"),
    "steps": Operator(_less("steps", "{u}"), stepped, STEPS, "size"),
    "friction": Operator(_of("friction", "{u}"), yielding, WIDTHS, "size", less=False, power=0),
    "side": Operator(_of("side", "{u}"), sided, FAR, "size", less=False, power=0),
    "peak": Operator(_of("peak", "s"), peaked, MEMORIES, less=False),
    "fall": Operator(_less("fall", "s"), falling, LATE),
    "rise": Operator(_less("rise", "s"), rising, LATE),
    "slew": Operator(_less("slew", "{u}/s"), slewing, SLEWS, "slope"),
    "swing": Operator(_less("swing", "Hz"), swinging, SWINGS),
    "sway": Operator(_less("sway", "Hz"), swaying, SWINGS),
    "echo": Operator(_less("echo", "s"), earlier, LATE),
    "smooth": Operator(_less("smooth", "s"), smoothed, (0.1, 0.3, 1.0)),
    "ghost": Operator(_of("echo", "s"), earlier, LATE, less=False),
    "frozen": Operator(_less("frozen", "rad/s of |omega|"), frozen, FREEZING, turning=True),
}
# Those that make something of one signal alone.
PLAIN = tuple(name for name, operator in OPERATORS.items() if not operator.turning)
# What is positive, or negative, of a signal.
SIDE = re.compile(r"max\((-?)(.+), 0\)")
# The sign of a signal.
SIGN = re.compile(r"tanh\((.+) / (.+)\)")
# Along which axis a device turns, where it turns fast enough.
_TURNS = r"\(\|omega\|, ([\d.e-]+)\)"
DIRECTION = re.compile(rf"\((omega_\S+) / max{_TURNS}\)")
# A signal, and a share of another one.
MIXED = re.compile(r"\((\S+) ([+-]) ([\d.e-]+) \* (\S+)\)")
# A wave once round the circle of headings.
BEARING = re.compile(r"cos\(yaw - ([\d.e-]+)\)")
_SAID = re.compile(r"\((\w+)\(([^ ]+) [^)]*\) of (.+?)( - \3)?\)")


def rounded(number: float) -> float:
    """A number with the digits that a driver's name has of it."""
    return float(f"{number:.{DIGITS}g}")


def said(operator: str, signal: str, unit: str, number: float) -> str:
    """How a driver with an operator is called."""
    return OPERATORS[operator].text.format(n=f"{number:.{DIGITS}g}", x=signal, u=unit)


def parsed(name: str) -> tuple[str, float, str] | None:
    """Operator, number and signal of a driver's name; None where it has none."""
    found = _SAID.fullmatch(name)
    if found is None:
        return None
    word, number, signal, less = found.groups()
    if not _closed(signal):  # (of a product of two such drivers)
        return None
    operator = _BY_WORD.get((word, bool(less)))
    return None if operator is None else (operator, float(number), signal)


def factors(name: str) -> tuple[str, str]:
    """The first factor of a driver that is a product, and the others; none where it is no
    product."""
    parts = name.split(" * ")
    for n in range(1, len(parts)):
        first = " * ".join(parts[:n])
        if _closed(first):
            return first, " * ".join(parts[n:])
    return name, ""


def _closed(text: str) -> bool:
    """Whether every bracket in it is closed, and none that is not open."""
    depth = 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if depth < 0:
            return False
    return depth == 0


def without_numbers(name: str) -> str:
    """A driver's name, but for the numbers of its operators, phases, and what is no turn yet."""
    name = BEARING.sub("cos(yaw)", _NUMBER.sub(r"(\1 ", name))
    name = MIXED.sub(r"(\1 \2 \4)", name)
    return re.sub(_TURNS, "(|omega|)", name)


def remembers(name: str) -> bool:
    """Whether there is an operator in a driver's name."""
    return _NUMBER.search(name) is not None


# Operators by the word for them, and whether the signal is taken away.
_BY_WORD = {(o.text[1:].partition("(")[0], o.less): name for name, o in OPERATORS.items()}
_WORDS = "|".join(sorted({word for word, _ in _BY_WORD}))
_NUMBER = re.compile(rf"\(({_WORDS})\([^ ]+ ")


def source(operator: str) -> tuple[str, str]:
    """Name and source, in plain numpy, of the function of an operator."""
    function: Any = OPERATORS[operator].of
    plain = inspect.unwrap(getattr(function, "py_func", function))
    text = inspect.getsource(plain)
    return plain.__name__, text[text.index("def ") :].replace("  # noqa: ARG001", "")
