"""Source of what a law without a name adds, in plain numpy, for somebody to edit.

A formula's text and its code are the same but for how numpy calls things. A curve is a table of
what is read too much, with a cubic spline through it.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence

import numpy as np

from handcal.effects import ATTITUDE, Z_DIM, Effect, Param, observed_error
from handcal.laws.driver_code import HELPERS, steps_to
from handcal.laws.drivers import AXES, HEADING, WARM
from handcal.laws.grammar import Form, text_of
from handcal.laws.law_effect import SENSORS, Law
from handcal.laws.terms import FASTEST, SLOW
from handcal.types import Array

# Columns of a line in a file that is to be read.
WIDE = 96
# Significant digits of a number as found: enough for a spline through a table to be that of the
# curve to a millionth.
DIGITS = 8

# Text of a formula, and how numpy says it.
_PYTHON = (
    (r"\bsin\(pitch of ([xy])\)", r"sin_pitch_\1"),
    (r"\bcos\(pitch of ([xy])\)", r"cos_pitch_\1"),
    (r"\bsin\(tilt\)\^2", "(1.0 - cos_tilt**2)"),
    (r"\bcos\(tilt\)", "cos_tilt"),
    (r"\byaw rate\b", "yaw_rate"),
    (re.escape(WARM), "warmth"),
    (r"\|omega\|", "turning"),
    (r"\bround\(([^()]+)\)", r"np.floor(\1 + 0.5)"),
    (r"([\d.]+) deg\b", r"np.radians(\1)"),
    (r"\b(\d) (x|yaw)\b", r"\1 * \2"),
    (r"\b(abs|tanh|clip|exp|sin|cos|sign|sqrt)\(", r"np.\1("),
    (r"\bmax\(", "np.maximum("),
    (r"- -", "+ "),
    (r"\^", "**"),
)


def python(text: str) -> str:
    """A formula's text as code."""
    for pattern, code in _PYTHON:
        text = re.sub(pattern, code, text)
    return text


def number(value: float) -> str:
    """A number as found, as code."""
    return f"{float(value):.{DIGITS}g}"


# --- errors of the IMU ---------------------------------------------------------------------------

# Without which there is nothing to say, and how a function asks for it.
_ABSENT = {"temperature": "signals.temperature", ATTITUDE: "signals.C_nb"}


def law_code(law: Law, formula: str, coefficients: Sequence[float], p: Sequence[Param]) -> str:
    """Source of a law over a driver; coefficients: of a curve, which p scales."""
    felt = "" if law.driver.factor is None else "felt * "
    if law.form.smooth:
        above = _curve_code(law, np.reshape(coefficients, (-1, law.form.constants)))
        names, texts = ["k"], [f"{felt}curve(x{', i' * law.each})"]
    else:
        above, names = "", _names(law.form)
        texts = [f"{felt}{python(text_of(x, DIGITS).format(x='x'))}" for x in law.form.parts]
    if law.sensor == HEADING:
        return above + _heading_columns(law, texts, formula)
    added = [f"{name} * {text}" for name, text in zip(names, texts, strict=True)]
    return above + imu_function(law, "x", added, formula, p)


def _heading_columns(law: Law, texts: Sequence[str], formula: str) -> str:
    """Source of ``heading``: what a unit of each constant makes a heading read too much."""
    says = f'"""``{formula}``: what a unit of each constant adds, rad, (n, {len(texts)})."""'
    lines = wrapped(says)
    for need in dict.fromkeys(law.driver.needs):
        lines += [f"if {_ABSENT[need]} is None:",
                  f"    return np.zeros((len(signals.t), {len(texts)}))"]  # fmt: skip
    lines += [*_driven(law, "x"), f"return np.column_stack([{', '.join(texts)}])"]
    return _with_helpers(_defined("heading(signals: Signals) -> Array:", lines))


def _driven(law: Law, x: str) -> list[str]:
    """Assignments to x, which drives a law, and to what that is multiplied by."""
    said, factor = f"# {law.driver.said(law.axis)}, {law.driver.unit}", law.driver.factor
    felt = [] if factor is None else steps_to("felt", _template(law, factor.name))
    return [said, *felt, *steps_to(x, _template(law, law.driver.over))]


def imu_function(
    law: Law, x: str, added: Sequence[str], formula: str, parameters: Sequence[Param]
) -> str:
    """Source of ``imu_error``, with what it calls: a sum of expressions of x (the driver's name in
    them) and of the constants, added to each of a law's axes."""
    names = ", ".join(_names(law.form)) + "," * (law.form.constants == 1 or law.form.smooth)
    lines = ["error = np.zeros((len(signals.t), 6))"]
    for need in dict.fromkeys(law.driver.needs):
        lines += [f"if {_ABSENT[need]} is None:", "    return error"]
    here, place = [], "i"
    if law.axis is not None:
        place = str(3 * law.sensor + law.axis)
    elif law.sensor:
        place = "3 + i"
    if law.each:
        here.append(f"{_left(names)} = p.reshape(3, -1)[i]")
    else:
        lines.append(f"{_left(names)} = p")
    here += _driven(law, x)
    here += _sum(f"error[:, {place}]", added)
    if law.axis is None:
        here = ["for i in range(3):", *(f"    {line}" for line in here)]
    units = ", ".join(dict.fromkeys(p.unit for p in parameters))
    says = f'"""``{formula}``; p ({len(parameters)},) {units}, result (n, 6)."""'
    lines = [*wrapped(says), *lines, *here, "return error"]
    return _with_helpers(_defined("imu_error(p: Array, signals: Signals) -> Array:", lines))


def _with_helpers(source: str) -> str:
    """The source after all that it calls (of which the first may be called by a later one)."""
    out = f"\n{source}"
    for name, text in reversed(HELPERS.items()):
        if f"{name}(" in out:
            out = text + out
    return out


def _left(names: str) -> str:
    return f"({names})" if names.endswith(",") else names


def _template(law: Law, name: str) -> str:
    """A driver's name, of the law's one axis or of i."""
    letters = "ijk" if law.axis is None else [AXES[(law.axis + n) % 3] for n in range(3)]
    return name if law.axis is None else name.format(i=letters[0], j=letters[1], k=letters[2])


def _names(form: Form) -> list[str]:
    one = form.smooth or form.constants == 1
    return ["k"] if one else [f"k{n + 1}" for n in range(form.constants)]


def _sum(left: str, added: Sequence[str]) -> list[str]:
    line = f"{left} = {' + '.join(added)}"
    if len(line) <= WIDE - 8:
        return [line]
    return [f"{left} = (", f"    {added[0]}", *(f"    + {more}" for more in added[1:]), ")"]


# --- curves --------------------------------------------------------------------------------------

_SPLINED = '''
def curve(x: Array{more}) -> Array:
    """What is read too much (n,) at x (n,): a cubic spline through the table, over arcsinh(x /
    NEAR), in which what is near zero is far apart, and a straight line."""
    at, value = CURVE[:, 0], CURVE[:, {column}]
    bent = CubicSpline(np.arcsinh(at / NEAR), value - SLOPE{own} * at)
    return SLOPE{own} * x + bent(np.arcsinh(np.clip(x, at[0], at[-1]) / NEAR))

'''
_WAVES = '''
def curve(x: Array{more}) -> Array:
    """What is read too much (n,) at the angle x (n,)."""
    waves = enumerate(CURVE{own}, 1)
    return sum((a * np.sin(n * x) + b * np.cos(n * x) for n, (a, b) in waves), np.zeros(len(x)))

'''


def _curve_code(law: Law, coefficients: Array) -> str:
    """The table of a curve (or of each axis's own), and a function that reads it."""
    each = {"more": ", i: int" * law.each, "own": "[i]" * law.each}
    unit, x = law.unit, law.driver.said(law.axis)
    if law.form.kind == "circle":
        rows = [_rows(c.reshape(-1, 2)) for c in coefficients]
        says = f"# Of sin(n yaw) and cos(n yaw), n = 1, 2, ..., {unit}, as found"
        if not law.each:
            return f"{says}.\n{_table(rows[0])}\n" + _WAVES.format(**each)
        several = [_within(axis) for axis in rows]
        return f"{says}, of x, y, z.\n{_table(several)}\n" + _WAVES.format(**each)
    low, high, near, knots, *_ = law.form.numbers
    at = _places(low, high, near, int(knots))
    slope = coefficients[:, -1] / max(abs(low), abs(high))
    values = law.form.values(at) @ coefficients.T
    slopes = ", ".join(number(s) for s in slope)
    head = f"# What {SENSORS[law.sensor]} reads too much ({unit}) over {x} ({law.driver.unit})"
    lines = [
        "# Below NEAR a curve may bend most; beyond the table it goes on by SLOPE.",
        f"NEAR = {number(near)}",
        f"SLOPE = np.array([{slopes}])" if law.each else f"SLOPE = {slopes}",
        f"{head}{', on x, y, z' * law.each}, as found.",
        _table(_rows(np.column_stack([at, values]))),
    ]
    column = "i + 1" if law.each else "1"
    return "\n".join(lines) + "\n" + _SPLINED.format(column=column, **each)


def _places(low: float, high: float, near: float, knots: int) -> Array:
    """Where a curve is written down: at its knots and amid the first and the last two. A spline
    through so many values has just the curve's freedom (it takes no knot next to either end)."""
    a, b = np.arcsinh(low / near), np.arcsinh(high / near)
    return np.asarray(near * np.sinh(np.interp(_steps(knots - 3), [0, knots - 3], [a, b])))


def _steps(spans: int) -> Array:
    inner = np.arange(1.0, spans)
    return np.concatenate([[0.0, 0.5], inner, [spans - 0.5, spans]])


def _rows(values: Array) -> list[str]:
    return [f"({', '.join(number(v) for v in row)})" for row in values]


def _within(rows: Sequence[str]) -> str:
    return "[\n" + "".join(f"        {row},\n" for row in rows) + "    ]"


def _table(rows: Sequence[str]) -> str:
    return "CURVE = np.array([\n" + "".join(f"    {row},\n" for row in rows) + "])\n"


# --- errors of the heading -----------------------------------------------------------------------

_SEEN = {
    "yaw": "np.arctan2(nav[9], nav[6])",
    "sin_pitch_x": "nav[12]",
    "sin_pitch_y": "nav[13]",
    "cos_pitch_x": "np.sqrt(max(1.0 - nav[12] ** 2, 0.0))",
    "cos_pitch_y": "np.sqrt(max(1.0 - nav[13] ** 2, 0.0))",
    "cos_tilt": "nav[14]",
    "yaw_rate": "nav[12] * nav[15] + nav[13] * nav[16] + nav[14] * nav[17]",
    "turning": "np.sqrt(nav[15] ** 2 + nav[16] ** 2 + nav[17] ** 2)",
    "t": "z[TIME]",
    "warmth": "z[WARMTH]",
}


def heading_function(code: str, formula: str, parameters: Sequence[Param], more: str = "") -> str:
    """Source of ``_heading``, which takes expressions of constants and of what is seen, one a line,
    off the heading's residual; more: lines before, of which they may speak."""
    seen = _used(_SEEN, code + more)
    lines = [f"{p.name} = p[{i}]" for i, p in enumerate(parameters)]
    lines += [f"{name} = {how}" for name, how in seen.items()]
    lines += [*more.splitlines(), *(f"r[0] -= {added}" for added in code.splitlines()), "return 0"]
    says = f'"""``{formula}``, rad: the reading less what it errs by."""'
    head = "_heading(nav: Any, p: Any, z: Any, r: Any) -> int:  # noqa: ARG001"
    return "\n" + _defined(head, [*wrapped(says), *lines])


# What drives a heading's curve, and what of it stands in the table.
_CURVED = {
    "yaw": "yaw",
    "pitch of x": "sin_pitch_x",
    "pitch of y": "sin_pitch_y",
    "tilt": "cos_tilt",
    "yaw rate": "yaw_rate",
}
_AT_X = """x = min(max({x}, AT[0]), AT[-1])
i = min(np.searchsorted(AT, x, side="right"), len(AT) - 1) - 1
d = x - AT[i]"""
_CUBIC = "k * (((C[0, i] * d + C[1, i]) * d + C[2, i]) * d + C[3, i])"


def heading_curve(effect: Effect, driver: str, coefficients: Array, p: Sequence[Param]) -> str:
    """Source of a curve of the heading over a driver, which p scales."""
    name = _CURVED[driver]
    at = _heading_places(driver, len(coefficients))
    values = observed_error(effect, "heading", coefficients, _navs(driver, at), _none(at), 1)
    warped = f"np.arcsinh(CURVE[:, 0] / {SLOW})" if driver == "yaw rate" else "CURVE[:, 0]"
    x = f"np.arcsinh(yaw_rate / {SLOW})" if driver == "yaw rate" else name
    round_ = ', bc_type="periodic"' if driver == "yaw" else ""
    values[-1] = values[0] if round_ else values[-1]
    lines = [
        f"# What the heading reads too much (rad) over {name}, as found.",
        _table(_rows(np.column_stack([at, values]))).rstrip(),
        f"AT = {warped}",
        f"C = CubicSpline(AT, CURVE[:, 1]{round_}).c",
    ]
    function = heading_function(_CUBIC, effect.id, p, _AT_X.format(x=x))
    return "\n".join(lines) + "\n\n" + function


def _heading_places(driver: str, knots: int) -> Array:
    if driver == "yaw":
        return np.linspace(-np.pi, np.pi, knots + 1)
    share = _steps(knots - 3) / (knots - 3)
    ends = FASTEST if driver == "yaw rate" else 1.0
    at = ends * (2.0 * share - 1.0)
    return np.asarray(SLOW * np.sinh(at)) if driver == "yaw rate" else at


def _navs(driver: str, at: Array) -> Array:
    """States (n, 21) in which the driver is this."""
    nav = np.zeros((len(at), 21))
    if driver == "yaw":
        nav[:, 6], nav[:, 9] = np.cos(at), np.sin(at)
    elif driver == "yaw rate":
        nav[:, 14], nav[:, 17] = 1.0, at
    else:
        nav[:, {"pitch of x": 12, "pitch of y": 13, "tilt": 14}[driver]] = at
    return nav


def _none(at: Array) -> Array:
    return np.zeros((len(at), Z_DIM))


# --- lines ---------------------------------------------------------------------------------------


def _used(vocabulary: Mapping[str, str], code: str) -> dict[str, str]:
    return {name: how for name, how in vocabulary.items() if re.search(rf"\b{name}\b", code)}


def _defined(head: str, lines: Sequence[str]) -> str:
    return f"def {head}\n" + "\n".join(f"    {line}" for line in lines) + "\n"


def wrapped(text: str) -> list[str]:
    """A text in lines, for a function's or a file's documentation."""
    return textwrap.wrap(text, WIDE - 4, break_long_words=False, break_on_hyphens=False)
