"""Forms that a law may have: a smooth curve, or a formula of a small grammar.

A form is a few functions of its driver x, each with a constant before it. What stands in a formula
beside its constants (a width, a limit) are its numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.compiled.jit import njit
from handcal.types import Array

# Scale below which a curve's knots are as far apart as near zero, of the driver's range: there
# sensors stick, lag and change sign, and a hand is slow most of the time.
NEAR_ZERO = 1.0 / 15.0
# Widths of a curve, in knots, and its sizes, of a clearly visible error.
WIDTHS, SIZES = (1.0, 2.5), (0.3, 1.0, 4.0)
# A number of a form is chosen from many: nats that it costs.
FREEDOM = 3.0
# Harmonics of a law round the circle.
HARMONICS = 3


# A function of the grammar, and its numbers.
Part = tuple[str, tuple[float, ...]]
# Between names of functions, in a form's kind: of a sum of those with numbers each of its own, and
# with the same ones (a wave has one period, a kink with a jump one place).
OWN, SAME = " + ", " & "


@dataclass(frozen=True)
class Form:
    """kind, numbers: by which it is made again; constants: how many (k); powers: of each constant
    that of the driver's unit; values(x (n,)) -> (n, k); root: square root (k, k) of the prior
    covariance of the constants, in their scales (None: the identity); texts, parts: of a formula
    each function of the driver {x}, and its name with its numbers; a curve has none."""

    kind: str
    numbers: tuple[float, ...]
    constants: int
    powers: tuple[float, ...]
    values: Callable[[Array], Array]
    root: Array | None = None
    texts: tuple[str, ...] = ()
    parts: tuple[Part, ...] = ()

    @property
    def smooth(self) -> bool:
        """Whether it is a curve without a formula."""
        return not self.texts

    @property
    def cost(self) -> float:
        """Nats by which a formula is less likely beforehand than the simplest: for its numbers, and
        for further functions, each one of many."""
        return 0.0 if self.smooth else _cost(self.numbers, self.parts)


def cost_of(parts: Sequence[Part], same: bool) -> float:
    """The cost of the formula of these functions (see ``Form`` and ``formula``)."""
    return _cost(_numbers(parts, same), parts)


def _cost(numbers: Sequence[float], parts: Sequence[Part]) -> float:
    return FREEDOM * len(numbers) + math.log(len(ATOMS)) * (len(parts) - 1)


def _numbers(parts: Sequence[Part], same: bool) -> tuple[float, ...]:
    """Those of a sum of functions: of each, or the same ones of all."""
    return tuple(n for _, numbers in _own(parts, same) for n in numbers)


def _own(parts: Sequence[Part], same: bool) -> Sequence[Part]:
    """The functions of a sum that have numbers of their own."""
    return parts[:1] if same else parts


# --- curves --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Range:
    """What a driver does in a recording: its ends, and the scale below which knots are evenly
    apart."""

    low: float
    high: float
    near: float

    @property
    def top(self) -> float:
        """The largest size."""
        return max(abs(self.low), abs(self.high))


def range_of(x: Array, signed: bool) -> Range:
    """The range of a driver; signed: with a zero where something may change."""
    low, high = (float(v) for v in np.quantile(x, [0.001, 0.999]))
    if signed:
        top = max(abs(low), abs(high), 1e-9)
        return Range(-top, top, NEAR_ZERO * top)
    return Range(low, max(high, low + 1e-9), max(high - low, 1e-9))


def curve(over: Range, knots: int, width: float, size: float) -> Form:
    """A smooth curve: cubic splines through knots that are denser near zero, and a line; the prior
    of its coefficients is a Gaussian process of this width (in knots) and size. It is zero
    where the driver is, or is nearest to it: what a sensor reads too much there is its bias."""
    apart = np.arange(1.0 * knots)[:, None] - np.arange(knots)
    root = np.eye(knots + 1)
    root[:knots, :knots] = process_root(apart, width)

    def splined(x: Array) -> Array:
        return _splined(np.ascontiguousarray(x), over.low, over.high, over.near, knots)

    at_zero = splined(np.array([min(max(0.0, over.low), over.high)]))

    def values(x: Array) -> Array:
        return splined(x) - at_zero

    numbers = (over.low, over.high, over.near, float(knots), width, size)
    powers = (0,) * (knots + 1)
    return Form("curve", numbers, knots + 1, powers, values, size * root)


def process_root(apart: Array, width: float) -> Array:
    """Square root (k, k) of the covariance of a smooth Gaussian process at knots so far apart
    (k, k), of size one."""
    K = np.exp(-0.5 * (apart / width) ** 2) + 1e-6 * np.eye(len(apart))
    return np.asarray(np.linalg.cholesky(K))


def circle(width: float, size: float) -> Form:
    """A smooth curve round the circle: harmonics, the higher the smaller (width: their decay)."""
    order = np.repeat(np.arange(1, HARMONICS + 1), 2)

    def values(x: Array) -> Array:
        parts = [f(n * x) for n in range(1, HARMONICS + 1) for f in (np.sin, np.cos)]
        return np.stack(parts, axis=1)

    root = np.diag(np.exp(-(order - 1.0) / (2.0 * width)))
    return Form("circle", (width, size), len(order), (0,) * len(order), values, size * root)


@njit
def _splined(x: Array, low: float, high: float, near: float, knots: int) -> Array:
    """Values (n, knots + 1) of the cubic splines, and of x over the range's size."""
    out = np.zeros((len(x), knots + 1))
    a, b = np.arcsinh(low / near), np.arcsinh(high / near)
    top = max(abs(low), abs(high))
    for i in range(len(x)):
        within = min(max(x[i], low), high)
        u = (np.arcsinh(within / near) - a) / (b - a) * (knots - 3)
        at = min(int(u), knots - 4)
        u -= at
        v = 1.0 - u
        out[i, at] = v * v * v / 6.0
        out[i, at + 1] = (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0
        out[i, at + 2] = (4.0 - 6.0 * v * v + 3.0 * v * v * v) / 6.0
        out[i, at + 3] = u * u * u / 6.0
        out[i, knots] = x[i] / top
    return out


def curves(over: Range, knots: int, round_: bool) -> list[Form]:
    """Curves of every width and size."""
    pairs = [(width, size) for width in WIDTHS for size in SIZES]
    if round_:
        return [circle(width, size) for width, size in pairs]
    return [curve(over, knots, width, size) for width, size in pairs]


# --- formulas ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Atom:
    """One function in a formula: text of the driver {x} and the numbers {0}, {1}; power of the
    driver's unit; values(x, *numbers); shares(range): numbers to begin with; sided: whether the
    driver has to have a sign for it to differ from another one."""

    text: str
    power: float
    values: Callable[..., Array]
    shares: Callable[[Range], Iterator[tuple[float, ...]]] = lambda _: iter([()])
    sided: bool = False


def _widths(*shares: float) -> Callable[[Range], Iterator[tuple[float, ...]]]:
    return lambda r: ((share * r.top,) for share in shares)


def _places(count: int, *widths: float) -> Callable[[Range], Iterator[tuple[float, ...]]]:
    def places(r: Range) -> Iterator[tuple[float, ...]]:
        for c in np.linspace(r.low, r.high, count + 2)[1:-1]:
            if not widths:
                yield (float(c),)
            for width in widths:
                yield float(c), width * (r.high - r.low)

    return places


# Directions in which a circle is halved on trial, and how blunt the edges are.
TURNED, BLUNT = 12, (0.1, 0.25, 0.6)


def _halves(_: Range) -> Iterator[tuple[float, ...]]:
    """Directions over half a circle (on the other half the constant is negative), and widths."""
    for c in np.linspace(0.0, math.pi, TURNED + 1)[1:]:
        for width in BLUNT:
            yield float(c), width


# (as far apart as two waves have to be for one to be found from the other)
_WAVES = _widths(*(1.0 / (math.pi * n) for n in range(1, 25)))
_LEAKS = _widths(0.1, 0.15, 0.25, 0.4, 0.7)
_LIMITS = _widths(0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8)
# (products, since numpy's power of negative numbers takes 40 times as long)
ATOMS: Mapping[str, Atom] = {
    "line": Atom("{x}", 1, lambda x: x),
    "square": Atom("{x}^2", 2, lambda x: x * x),
    "cube": Atom("{x}^3", 3, lambda x: x * x * x),
    "size": Atom("abs({x})", 1, np.abs, sided=True),
    "signed square": Atom("{x} * abs({x})", 2, lambda x: x * np.abs(x), sided=True),
    "size cubed": Atom("abs({x})^3", 3, lambda x: np.abs(x) * x * x, sided=True),
    "upper square": Atom("max({x}, 0)^2", 2, lambda x: np.maximum(x, 0.0) ** 2, sided=True),
    "lower square": Atom("max(-{x}, 0)^2", 2, lambda x: np.maximum(-x, 0.0) ** 2, sided=True),
    "growth": Atom("exp({x} / {0})", 0, lambda x, s: np.exp(x / s), _LEAKS),
    "decline": Atom("exp(-{x} / {0})", 0, lambda x, s: np.exp(-x / s), _LEAKS),
    "fifth power": Atom("{x}^5", 5, lambda x: (x * x) * (x * x) * x),
    "root": Atom("sqrt(abs({x}))", 0.5, lambda x: np.sqrt(np.abs(x))),
    "signed root": Atom(
        "sign({x}) * sqrt(abs({x}))", 0.5, lambda x: np.sign(x) * np.sqrt(np.abs(x)), sided=True
    ),
    "sign": Atom(
        "tanh({x} / {0})", 0, lambda x, w: np.tanh(x / w),
        _widths(0.002, 0.006, 0.02, 0.05, 0.12, 0.3),
    ),
    "compression": Atom(
        "({x} - {0} * tanh({x} / {0}))", 1, lambda x, s: x - s * np.tanh(x / s),
        _widths(0.2, 0.35, 0.6, 1.0, 1.6),
    ),
    "dead zone": Atom(
        "clip({x}, -{0}, {0})", 1, lambda x, d: np.clip(x, -d, d),
        _widths(0.01, 0.025, 0.05, 0.1, 0.2, 0.35, 0.5),
    ),
    "limit": Atom(
        "({x} - clip({x}, -{0}, {0}))", 1, lambda x, d: x - np.clip(x, -d, d), _LIMITS, sided=True
    ),
    "excess": Atom(
        "max(abs({x}) - {0}, 0)", 1, lambda x, d: np.maximum(np.abs(x) - d, 0.0), _LIMITS,
        sided=True,
    ),
    "jump": Atom(
        "sign({x}) * (abs({x}) > {0})", 0, lambda x, d: np.sign(x) * (np.abs(x) > d), _LIMITS,
        sided=True,
    ),
    "beyond": Atom("max({x} - {0}, 0)", 1, lambda x, c: np.maximum(x - c, 0.0), _places(12)),
    "step": Atom("({x} > {0})", 0, lambda x, c: (x > c).astype(np.float64), _places(12)),
    "rise": Atom(
        "tanh(({x} - {0}) / {1})", 0, lambda x, c, w: np.tanh((x - c) / w),
        _places(12, 0.01, 0.03, 0.08),
    ),
    "bump": Atom(
        "exp(-(({x} - {0}) / {1})^2 / 2)", 0,
        lambda x, c, w: np.exp(-0.5 * ((x - c) / w) ** 2), _places(9, 0.02, 0.05, 0.12),
    ),
    "resonance": Atom(
        "1 / (1 + (({x} - {0}) / {1})^2)", 0, lambda x, c, w: 1.0 / (1.0 + ((x - c) / w) ** 2),
        _places(9, 0.03, 0.1, 0.3),
    ),
    "decay": Atom(
        "exp(-abs({x}) / {0})", 0, lambda x, s: np.exp(-np.abs(x) / s),
        _widths(0.01, 0.03, 0.1, 0.3, 1.0),
    ),
    "sine": Atom("sin({x} / {0})", 0, lambda x, p: np.sin(x / p), _WAVES),
    "cosine": Atom("cos({x} / {0})", 0, lambda x, p: np.cos(x / p), _WAVES),
}  # fmt: skip
ROUND: Mapping[str, Atom] = {
    f"{name} {n}": Atom(
        f"{name}({n} {{x}})" if n > 1 else f"{name}({{x}})", 0, lambda x, f=f, n=n: f(n * x)
    )
    for n in range(1, HARMONICS + 1)
    for name, f in (("sin", np.sin), ("cos", np.cos))
} | {
    "halves": Atom(
        "tanh(cos({x} - {0}) / {1})", 0, lambda x, c, w: np.tanh(np.cos(x - c) / w), _halves
    )
}  # fmt: skip

# In a sum with what a gain does: the gain that it has besides (alone that is a scale error).
LEVEL: Part = ("level", ())
_KNOWN: Mapping[str, Atom] = {**ATOMS, **ROUND, LEVEL[0]: Atom("1", 0, np.ones_like)}


def formula(parts: Sequence[Part], same: bool = False) -> Form:
    """The sum of these functions, each with a constant before it and its numbers, or all with the
    same numbers."""
    atoms = [(_KNOWN[name], numbers) for name, numbers in parts]

    def values(x: Array) -> Array:
        return np.stack([a.values(x, *numbers) for a, numbers in atoms], axis=1)

    return Form(
        (SAME if same else OWN).join(name for name, _ in parts),
        _numbers(parts, same),
        len(atoms),
        tuple(a.power for a, _ in atoms),
        values,
        texts=tuple(text_of(part) for part in parts),
        parts=tuple(parts),
    )


def shorter(form: Form) -> Iterator[tuple[Form, list[int]]]:
    """A sum without each of its functions, and which constants are left."""
    if len(form.parts) < 2:
        return
    for out in range(len(form.parts)):
        kept = [k for k in range(len(form.parts)) if k != out]
        rest = [form.parts[k] for k in kept]
        yield formula(rest, SAME in form.kind and len(rest) > 1), kept


def parts_for(over: Range, signed: bool, round_: bool, gain: bool = False) -> list[Part]:
    """Every function of the grammar for a driver, with the numbers to begin with; gain: whether the
    law is a gain of something."""
    return [LEVEL] * gain + [
        (name, numbers)
        for name, atom in (ROUND if round_ else ATOMS).items()
        if signed or not atom.sided
        for numbers in atom.shares(over)
    ]


def about(part: Part, share: float) -> list[Part]:
    """The function with its numbers as they are, and up to so much larger and smaller."""
    name, numbers = part
    out = [part]
    for n, (value, unit) in enumerate(zip(numbers, _units(part), strict=True)):
        for step in (-1.0, -0.5, 0.5, 1.0):
            other = value + unit * math.expm1(step * share)
            out.append((name, (*numbers[:n], other, *numbers[n + 1 :])))
    return out


def _units(part: Part) -> tuple[float, ...]:
    """By what each number of a function is changed: in proportion, but a place by no less than the
    width about it (one at zero would stay there)."""
    _, numbers = part
    if len(numbers) != 2:
        return numbers
    place, width = numbers
    return (place if abs(place) > width else width), width


def units_of(form: Form) -> tuple[float, ...]:
    """The same of all numbers of a formula."""
    return tuple(u for part in _own(form.parts, SAME in form.kind) for u in _units(part))


def text_of(part: Part, digits: int = 4) -> str:
    """The function as text with its numbers, the driver {x} still open."""
    name, numbers = part
    text = _KNOWN[name].text.format(*(f"{n:.{digits}g}" for n in numbers), x="{x}")
    return text.replace("- -", "+ ")


def again(kind: str, numbers: tuple[float, ...]) -> Form:
    """The form of this kind, of the first of these numbers. Raises KeyError for an unknown one."""
    if kind == "curve":
        low, high, near, knots, width, size = numbers[:6]
        return curve(Range(low, high, near), int(knots), width, size)
    if kind == "circle":
        return circle(*numbers[:2])
    parts: list[Part] = []
    same = SAME in kind
    for name in kind.split(SAME if same else OWN):
        count = len(next(iter(_KNOWN[name].shares(Range(-1.0, 1.0, 0.1)))))
        parts.append((name, tuple(numbers[:count])))
        numbers = numbers if same else numbers[count:]
    return formula(parts, same)
