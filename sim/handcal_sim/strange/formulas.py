"""What a formula of an explanation adds to a channel, by its text and its constants."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping
from types import CodeType
from typing import Any

import numpy as np

from handcal_sim.profiles import Array
from handcal_sim.strange.law import signal
from handcal_sim.strange.memory import followed, lagged, passed, stuck
from handcal_sim.strange.words import of_channel
from handcal_sim.strangers import Scene

# Slower than this (rad/s) a device does not turn, for laws of the time since the last turn.
TURNING = 0.2
# Temperature above which drivers have it, degC.
ROOM = 25.0


def _spans(found: re.Match[str]) -> str:
    ends = re.findall(r"([-\d.]+) s to ([-\d.]+) s", found[1])
    return "(" + " | ".join(f"((t >= {a}) & (t <= {b}))" for a, b in ends) + ")"


def _each(found: re.Match[str]) -> str:
    moments = found[2].split(", ")
    return "(" + " + ".join(found[1].replace("t_n", f"({at})") for at in moments) + ")"


# A formula's text, in turn, and the same in Python.
_UNITS = r"(?:s|Hz|K|m/s\^[23]|rad/s(?:\^2)?|rad|1)(?:/s)?(?: of \|omega\|)?"
_PAST_OF = re.compile(rf"\((\w+)\(([\d.e+-]+) {_UNITS}\) of ")
_PYTHON: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    # (courses over time: one after another, and what begins at once)
    (r"\(t from ([^()]+)\)", _spans),
    (r"\(sum of (.+) for t_n = ([-\d., ]+) s\)", _each),
    (r"\(t >= ([^ ]+)(?: s)?\) exp\(-\(t - ([^ ]+)(?: s)?\)", r"(t >= \1) * exp(-max(t - \2, 0)"),
    (r"\) sin\(", r") * sin("),
    (r" mod ", r" % "),
    (r"\b2 pi \(t ([\d.e+-]+) Hz ([+-]) t\^2 ([\d.e+-]+) Hz/s\)",
     r"2 * pi * (t * \1 \2 t^2 * \3)"),
    (r"\bsin\(pitch of ([xy])\)", r"up_\1"),
    (r"\bpitch of ([xy])", r"arcsin(up_\1)"),
    (r"\byaw rate", "turn"),
    (r"\byaw\b", "heading"),
    (r"\(time since a turn\)", "since()"),
    (r"\|((?:\(|up_|cos)[^|]*)\|", r"abs(\1)"),
    (r"\|(\w+)\|", r"size_\1"),
    (r"([\d.e+-]+) deg\b", r"radians(\1)"),
    (r"(\d) s\b", r"\1"),
    (r"\b2 pi t\b", "2 * pi * t"),
    (r"(?<![\w.])(\d+) heading\b", r"\1 * heading"),
    (r"(?<![\w.])([\d.]+) \(", r"\1 * ("),
    (r"\^", "**"),
)  # fmt: skip
_PLAIN = (ast.Expression, ast.BinOp, ast.UnaryOp, ast.Compare, ast.Call, ast.Name, ast.Constant,
          ast.operator, ast.unaryop, ast.cmpop, ast.expr_context)  # fmt: skip


def value_of(entry: Mapping[str, Any], channel: str, at: Scene) -> Array:
    """What an entry of ``unnamed`` with constants adds (n,). Raises KeyError, NameError, TypeError
    or SyntaxError for what is not understood here."""
    text = _called(entry["formula"].partition(" += ")[2])
    for pattern, code in _PYTHON:
        text = re.sub(pattern, code, text)
    text = re.sub(r"\b(size_)?((?:omega|f|alpha|jerk|north)_[ijk])\b",
                  lambda m: (m[1] or "") + of_channel(m[2], channel), text)  # fmt: skip
    text = re.sub(r"\b(k\d?)_i\b", rf"\1_{channel[-1]}", text)
    names = {c["name"]: c["value"] for c in entry["constants"]}
    names |= {name: _driver(name, at) for name in _signals(text)}
    added = eval(_checked(text), {"__builtins__": {}}, {**_functions(at), **names})
    return np.asarray(added, dtype=np.float64) * np.ones(len(at.t))


def _called(text: str) -> str:
    """The text with each ``(memory(2 s) of x - x)`` as a call, the innermost first."""
    while found := list(_PAST_OF.finditer(text)):
        one = found[-1]
        end, depth = one.end(), 1
        while depth:
            depth += (text[end] == "(") - (text[end] == ")")
            end += 1
        body = text[one.end() : end - 1]
        half = (len(body) - 3) // 2
        less = body[:half] + " - " + body[:half] == body
        x = body[:half] if less else body
        call = f"({one[1]}({one[2]}, ({x})){f' - ({x})' if less else ''})"
        text = text[: one.start()] + call + text[end:]
    return text


def _checked(text: str) -> CodeType:
    """Arithmetic on names, numbers and calls of names, and nothing else. Raises SyntaxError."""
    tree = ast.parse(text, mode="eval")
    for node in ast.walk(tree):
        if not isinstance(node, _PLAIN) or (
            isinstance(node, ast.Call) and not isinstance(node.func, ast.Name)
        ):
            raise SyntaxError(text)
    return compile(tree, "formula", "eval")


def _signals(text: str) -> set[str]:
    pattern = (
        r"\b((?:size_)?(?:omega|f|alpha|jerk|north)(?:_[xyz])?|up_[xy]|tilt|turn|heading|T|t)\b"
    )
    return set(re.findall(pattern, text))


def _driver(name: str, at: Scene) -> Array:
    if name == "T":
        return np.asarray(at.warm + ROOM)
    if name == "t":
        return np.asarray(at.t - at.t[0])
    if name.startswith("size_"):
        return signal(at, f"|{name.removeprefix('size_')}|")
    # (what has a memory does not jump where a heading begins again)
    return np.unwrap(signal(at, name)) if name == "heading" else signal(at, name)


def _functions(at: Scene) -> dict[str, Any]:
    names = "sin cos tanh exp abs sign sqrt clip arcsin radians round"
    plain: dict[str, Any] = {name: getattr(np, name) for name in names.split()}
    past = {name: _of(f, at.t) for name, f in _PAST.items()}
    past["frozen"] = lambda slow, x: _held(np.asarray(x), signal(at, "|omega|") <= slow)
    return plain | past | {"max": np.maximum, "pi": math.pi, "since": lambda: since_a_turn(at)}


def _of(function: Callable[[Array, float, Array], Array], t: Array) -> Callable[..., Array]:
    return lambda number, x: function(t, number, np.asarray(x, dtype=np.float64))


def since_a_turn(at: Scene) -> Array:
    """Time (n,) since the device was last being turned, s."""
    turned = signal(at, "|omega|") > TURNING
    return np.asarray(at.t - np.maximum.accumulate(np.where(turned, at.t, at.t[0])))


def _side(_t: Array, far: float, x: Array) -> Array:
    out = np.where(np.abs(x) > far, np.sign(x), 0.0)
    last = np.maximum.accumulate(np.where(out != 0.0, np.arange(len(x)), -1))
    return np.where(last >= 0, out[np.maximum(last, 0)], 0.0)


def _held(x: Array, free: Array) -> Array:
    """x where it is free, and else as it was then."""
    last = np.maximum.accumulate(np.where(free, np.arange(len(x)), 0))
    return np.asarray(x[last])


def _stepwise(move: Callable[[float, float, float, float], float]) -> Callable[..., Array]:
    """What goes from its last value to one that depends on x now: move(at, x, dt, number)."""

    def course(t: Array, number: float, x: Array) -> Array:
        out, at = np.empty(len(x)), float(x[0])
        for n, (now, dt) in enumerate(zip(x.tolist(), np.diff(t, prepend=t[0]), strict=True)):
            out[n] = at = move(at, now, float(dt), number)
        return out

    return course


def _toward(at: float, x: float, dt: float, tau: float) -> float:
    return at - math.expm1(-dt / tau) * (x - at)


def _slew(at: float, x: float, dt: float, fast: float) -> float:
    return at + min(max(x - at, -fast * dt), fast * dt)


def _bent(_t: Array, width: float, x: Array) -> Array:
    out, at = np.zeros(len(x)), 0.0
    for n, dx in enumerate(np.diff(x).tolist(), start=1):
        way = math.copysign(1.0, dx)
        out[n] = at = way - (way - at) * math.exp(-abs(dx) / width)
    return out


def _peak(t: Array, tau: float, x: Array) -> Array:
    out, at = np.empty(len(x)), 0.0
    for n, (now, dt) in enumerate(zip(np.abs(x).tolist(), np.diff(t, prepend=t[0]), strict=True)):
        out[n] = at = max(now, at * math.exp(-float(dt) / tau))
    return out


def _swung(damping: float) -> Callable[[Array, float, Array], Array]:
    def course(t: Array, hz: float, x: Array) -> Array:
        w = 2.0 * math.pi * hz
        return np.asarray(passed(t, x, [w * w], [1.0, 2.0 * damping * w, w * w], "foh") + x[0])

    return course


_PAST: Mapping[str, Callable[[Array, float, Array], Array]] = {
    "memory": lambda t, tau, x: lagged(t, x, tau),
    "smooth": lambda t, tau, x: lagged(-t[::-1], lagged(t, x, tau)[::-1], tau)[::-1],
    "play": lambda _t, half, x: followed(x, half),
    "stick": lambda _t, loose, x: stuck(x, loose),
    "steps": lambda _t, step, x: step * np.floor(x / step + 0.5),
    "echo": lambda t, late, x: np.interp(t - late, t, x),
    "fall": _stepwise(lambda at, x, dt, tau: _toward(at, x, dt, tau) if x < at else x),
    "rise": _stepwise(lambda at, x, dt, tau: _toward(at, x, dt, tau) if x > at else x),
    "slew": _stepwise(_slew),
    "friction": _bent,
    "side": _side,
    "peak": _peak,
    "swing": _swung(0.1),
    "sway": _swung(0.3),
}
