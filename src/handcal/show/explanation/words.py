"""The words of an explanation, the same in terminal, report and dashboard: numbers, titles, units.

Everything is a short phrase; units and digits come from ``handcal.show.words``. Whole sentences
are in ``verdict_text``.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from handcal.effects import catalogue
from handcal.explanation import (
    Explained,
    Explanation,
    Hypothesis,
    Mismatch,
    Missing,
    Unnamed,
    is_curve,
)
from handcal.laws.law_effect import law_made
from handcal.show import words
from handcal.show.words import NBSP, effect_title, listed
from handcal.types import Parameter
from handcal.units import DEG, Shown, is_number, plain, shown

_UNITS = {
    "gyro": Shown("deg/s", DEG), "accel": Shown("m/s²", 1.0),
    "heading": Shown("deg", DEG), "attitude": Shown("deg", DEG),
    "mag": Shown("µT", 1e6),
}  # fmt: skip
_SMALL = {"accel": "m/s^2", "position": "m", "velocity": "m/s"}
# A law in one line of the terminal: so many signs, of these heights.
SPARKS, BLOCKS = 32, "▁▂▃▄▅▆▇█"
LABEL = 36  # signs in a line of a label at the left of a drawing
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def counted_word(n: int) -> str:
    """ "three"; figures beyond ten."""
    return _NUMBERS[n] if n < len(_NUMBERS) else str(n)


def percent(share: float) -> str:
    """A share or probability, never rounded to 0 or 100 %."""
    p = 100 * share
    if not math.isfinite(p):
        return "–"
    if p > 99.9:
        return f"over 99.9{NBSP}%"
    if p < 0.1:
        return f"under 0.1{NBSP}%"
    tenths = p > 99 or p < 1
    return f"{p:.1f}{NBSP}%" if tenths else f"{p:.0f}{NBSP}%"


def whole_percent(share: float) -> str:
    """A share of a total, to a whole percent; a little is not nothing."""
    if 0.0 < share < 0.005:
        return f"under 1{NBSP}%"
    return f"{100 * share:.0f}{NBSP}%" if math.isfinite(share) else "–"


def number(value: float) -> str:
    """ "1,240", "−3.1", "0.4"."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:,.0f}" if abs(value) >= 10 else f"{value:.1f}"
    return text.replace("-", "−") if float(text.replace(",", "")) else text.replace("-", "")


def first(hypothesis: Hypothesis) -> float:
    """Nats that it gains when added first; NaN of noise, which is fitted beside what was found and
    never alone."""
    return hypothesis.alone if math.isfinite(hypothesis.expected) else math.nan


def expected(hypothesis: Hypothesis) -> str:
    """What an effect of the usual size would gain; less than nothing is nothing."""
    return number(max(hypothesis.expected, 0.0))


def markers(e: Explanation) -> list[str]:
    """How the marker of each recording's pose is turned on the device."""
    told = [words.marker_sentence(r.marker) for r in e.recordings]
    names = recording_names(e)
    several = len(names) > 1
    return [f"{n}: {s}" if several else s for n, s in zip(names, told, strict=True) if s]


def change(before: float, after: float) -> str:
    """ "−44 %"; nothing to say where there is no before."""
    if not (math.isfinite(before) and math.isfinite(after) and before > 0):
        return "–"
    by = round(100 * (after / before - 1))
    return f"{by:+d}{NBSP}%".replace("-", "−") if by else f"0{NBSP}%"


def nats(value: float) -> str:
    """The number with its unit."""
    return f"{number(value)}{NBSP}nats"


def the(title: str) -> str:
    """A title within a sentence: "the gyro scale error"; capitals of names are kept."""
    first = title.split(" ", 1)[0]
    if title == "Gravity":
        return "gravity"
    keep = first in ("Earth", "Coriolis") or first[1:] != first[1:].lower() or len(first) == 1
    return "the " + (title if keep else title[:1].lower() + title[1:])


def source(channel: str, of: Explained) -> str:
    """Where the readings of a channel are from: without a pose, places are assumed."""
    if channel.startswith("position") and "pose" not in of.recording.streams:
        return "held point (assumed)"
    if channel.startswith("velocity"):
        return "standstill (assumed)"
    return "recorded"


def channel_shown(channel: str, values: Sequence[float], small: bool = False) -> Shown:
    """The friendly unit of a channel's readings; small: of its residuals."""
    sensor = channel.rpartition("_")[0] if channel[-2:-1] == "_" else channel
    if sensor in _SMALL and (small or sensor not in _UNITS):
        return shown(_SMALL[sensor], values)
    return _UNITS.get(sensor, Shown("", 1.0))


def channels(*each: Mapping[str, float]) -> list[str]:
    """All channels of several mappings, sensors first, in the order of the contract."""
    order = ("gyro", "accel", "heading", "mag", "position", "velocity", "attitude")
    found = dict.fromkeys(c for m in each for c in m)

    def rank(channel: str) -> tuple[int, str]:
        sensor = channel.rpartition("_")[0] if channel[-2:-1] == "_" else channel
        return (order.index(sensor) if sensor in order else len(order), channel)

    return sorted(found, key=rank)


def title_of(effect: str, explanation: Explanation) -> str:
    """The title of an effect that may be on trial, or else of the catalogue."""
    known = {h.effect: h.title for h in explanation.hypotheses}
    known |= {m.effect: m.title for m in explanation.missing}
    return known.get(effect) or effect_title(effect)


def members(missing: Missing, explanation: Explanation) -> list[str]:
    """Titles of an effect and of those it cannot be told from."""
    others = [title_of(e, explanation) for e in missing.indistinguishable_from]
    return [missing.title, *others]


def either(titles: Sequence[str]) -> str:
    """ "the gravity, the lever arm or the accelerometer scale error"."""
    return listed([the(t) for t in titles], "or")


def probable(hypothesis: Hypothesis, explanation: Explanation) -> str:
    """Its probability; a dash where the search ended before it was weighed."""
    return percent(hypothesis.probability if weighed(hypothesis, explanation) else math.nan)


def weighed(hypothesis: Hypothesis, explanation: Explanation) -> bool:
    """Whether the search came so far."""
    return bool(hypothesis.verdict) or not explanation.untried


def one_model(explanation: Explanation) -> bool:
    """Whether nothing was added, so that plain and final model are the same."""
    return not explanation.unnamed and all(map(is_always, explanation.missing))


def is_always(m: Missing) -> bool:
    """Whether the effect is in the baseline too."""
    known = catalogue().get(m.effect)
    return known is not None and known.always


def gain(explanation: Explanation) -> float:
    """Nats that the final model gains over the baseline."""
    return explanation.after.log_evidence - explanation.before.log_evidence


def recording_names(explanation: Explanation) -> list[str]:
    """File names without folders."""
    return [Path(r.recording.path).name for r in explanation.recordings]


def of_recording(index: int, explanation: Explanation) -> str:
    """ " of walk.mcap" where there are several recordings."""
    names = recording_names(explanation)
    return f" of {names[index]}" if len(names) > 1 and 0 <= index < len(names) else ""


def lawless(u: Unnamed) -> bool:
    """Whether it is an error that goes with the motion, and no law."""
    return u.formula.partition(" += ")[2].startswith("e(")


def in_lines(formula: str) -> str:
    """A formula as a label at the left of a drawing."""
    channel, _, law = formula.partition(" += ")
    return "\n".join([f"{channel} +=", *textwrap.wrap(law, LABEL, break_on_hyphens=False)])


def interval(m: Mismatch) -> str:
    """ "12–31 s", finer where that would be nothing."""
    digits = 0 if m.to_s - m.from_s >= 2 else 1
    return f"{m.from_s:.{digits}f}–{m.to_s:.{digits}f}{NBSP}s"


def in_units(parameters: Sequence[Parameter]) -> list[tuple[Parameter, Shown]]:
    """Each with its unit, which it shares with those of its effect."""
    groups = words.by_effect(parameters).values()
    return [(p, unit) for group in groups for unit in [words.shown_group(group)] for p in group]


def sized(u: Unnamed) -> str:
    """ "k = 0.012 ± 0.001 rad/s"; each constant of a formula; the size of a curve."""
    if len(u.constants) > 1:
        return ", ".join(f"{c.name} = {amount(c)}" for c in u.constants)
    if lawless(u) or is_curve(u.formula):
        return f"a size of {amount(u)} (root mean square)"
    return f"k = {amount(u)}"


def over_what(u: Unnamed) -> str:
    """Over what its curve is drawn."""
    if lawless(u):
        return "t"
    law = law_made(u.made)
    return ", ".join(u.drivers) or "driver" if law is None else law.driver.said(law.axis)


def of_what(u: Unnamed) -> str:
    """The signal of which a law says how much is felt; empty where it says what is added."""
    law = law_made(u.made)
    factor = None if law is None else law.driver.factor
    return "" if law is None or factor is None else factor.said(law.axis)


def sparkline(u: Unnamed) -> str:
    """The law's curve in one line, over its driver from end to end; empty if there is none."""
    c = u.curve
    if c is None or len(c.x) < 3 or len(u.drivers) != 1:
        return ""
    x = np.linspace(c.x[0], c.x[-1], SPARKS)
    y = np.interp(x, c.x, c.y)
    low, high = float(y.min()), float(y.max())
    steps = np.rint((y - low) / max(high - low, 1e-300) * (len(BLOCKS) - 1)).astype(int)
    unit, over = shown(c.y_unit, [low, high]), shown(c.x_unit, c.x.tolist())
    ends = [plain(v * over.factor, 3) for v in (c.x[0], c.x[-1])]
    least = 0.01 * max(abs(low), abs(high))
    sizes = [plain(v * unit.factor if abs(v) > least else 0.0, 2) for v in (low, high)]
    line = "".join(BLOCKS[k] for k in steps)
    driver = f"{over.unit} over {over_what(u)}".lstrip()
    return f"{ends[0]} {line} {ends[1]} {driver}; {sizes[0]} to {sizes[1]} {unit.unit}"


def amount(u: Unnamed | Parameter) -> str:
    """A size with its uncertainty; powers of ten where it is tiny."""
    sigma = abs(u.sigma)
    if not (math.isfinite(u.value) and math.isfinite(sigma) and sigma > 0):
        return f"{u.value:.3g}".replace("-", "−") if math.isfinite(u.value) else "unknown"
    power = math.floor(math.log10(max(abs(u.value), sigma)))
    power = 0 if -3 < power < 5 else power
    digits = min(max(1 - math.floor(math.log10(sigma / 10.0**power)), 0), 7)
    value, spread = (f"{v / 10.0**power:.{digits}f}" for v in (u.value, sigma))
    text = f"{value} ± {spread}".replace("-", "−")
    if power:
        text = f"({text})·10{str(power).translate(_SUPERSCRIPT)}"
    powers = re.sub(r"\^(\d)", lambda m: m[1].translate(_SUPERSCRIPT), u.unit)
    unit = "" if is_number(u.unit) else f" {powers}"
    return text + unit
