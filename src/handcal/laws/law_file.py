"""A law without a name as a file of the catalogue, to be edited and read in again.

Two steps: ``law_of`` says what a file has to hold of something found, one function for each kind
of it (a law over a driver, a course, a formula or a curve of the heading), and ``text_of`` puts
that into a file like those in ``handcal.effects``.

A curve becomes a table of what was found, times one constant that is one there. A second recording
tells one number well, and what the first one saw stays where the second does not go; coefficients
that are free again would have no more to go by than the second has seen. And a table of readings
over what drives them is something that a person can mend.
"""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from handcal import output
from handcal.effects import Param
from handcal.explanation import Unnamed
from handcal.laws import grammar, law_effect, terms
from handcal.laws.drivers import AXES, DRIVERS
from handcal.laws.law_code import (
    WIDE,
    heading_curve,
    heading_function,
    imu_function,
    law_code,
    number,
    python,
    wrapped,
)
from handcal.types import HandcalError, InputError


@dataclass(frozen=True)
class Law:
    """What a file says of a law.

    title, story, motion: as of an ``Effect``; parameters: their priors are what was found. code:
    source of its constants and functions, among them ``imu_error``, ``_heading``, a residual
    function, or ``heading`` (``Effect.seen``); needs: streams or the attitude; of_one_day:
    another day it is another.
    """

    title: str
    story: str
    motion: str
    parameters: tuple[Param, ...]
    code: str
    needs: tuple[str, ...] = ()
    of_one_day: bool = False

    @property
    def of_heading(self) -> bool:
        return "def _heading(" in self.code

    @property
    def of_past(self) -> bool:
        """Of a heading that depends on more than a moment."""
        return "def heading(" in self.code


# --- what a file holds ---------------------------------------------------------------------------


def law_of(u: Unnamed) -> Law:
    """What a file has to hold of an unnamed law. Raises HandcalError for a kind that none can."""
    kind = u.made[0] if u.made is not None else ""
    try:
        if law_effect.is_law(kind):
            return _over_driver(u)
        if kind.startswith(terms.CURVE):
            return _curve_of_heading(u)
        return _formula_of_heading(u) if u.made is None else COURSES[kind](u)
    except InputError:
        raise
    except (KeyError, ValueError):
        raise HandcalError(f"{u.formula} cannot be written as an effect file.") from None


def _over_driver(u: Unnamed) -> Law:
    """A law over a driver, on one axis or on three."""
    assert u.made is not None
    law = law_effect.again(*u.made)
    if law.form.smooth:
        _complete(u, len(law.parameters))
        parameters = _scales(AXES if law.each else "")
    else:
        parameters = _found(u, law.parameters)
    code = law_code(law, u.formula, u.coefficients, parameters)
    return replace(_law(u, parameters, code), needs=law.driver.needs)


def _formula_of_heading(u: Unnamed) -> Law:
    """A formula of the heading's attitude, rate or time."""
    again = terms.again(u.formula, 1.0)
    parameters = _found(u, again.parameters)
    code = heading_function(python(u.formula.partition(" += ")[2]), u.formula, parameters)
    return replace(_law(u, parameters, code), needs=again.needs)


def _curve_of_heading(u: Unnamed) -> Law:
    """A curve of the heading."""
    assert u.made is not None
    driver = u.made[0].removeprefix(terms.CURVE)
    effect, parameters = terms.curve(driver, *u.made[1]), _scales()
    _complete(u, len(effect.parameters))
    code = heading_curve(effect, driver, np.array(u.coefficients), parameters)
    return _law(u, parameters, code)


def _complete(u: Unnamed, count: int) -> None:
    if len(u.coefficients) != count:
        raise ValueError(f"{count} coefficients, not {len(u.coefficients)}")


def _course(
    code: str,
    numbers: Sequence[tuple[str, str]],
    of_one_day: bool = False,
    moment: int = 0,
) -> Callable[[Unnamed], Law]:
    """Courses over time or direction (``shapes``) whose numbers have these names and units; moment:
    how many of the first ones each time has at which it comes again."""

    def law(u: Unnamed) -> Law:
        assert u.made is not None
        (channel,) = u.channels
        codes, all_numbers = [code], list(numbers)
        for n in range(2, 2 + (len(u.made[1]) - len(numbers)) // max(1, moment)):
            own = [(f"{name}_{n}", unit) for name, unit in numbers[:moment]]
            another = code
            for (name, _), (new, _) in zip(numbers, own, strict=False):
                another = re.sub(rf"\b{name}\b", new, another)
            codes.append(another)
            all_numbers += own
        named = zip(all_numbers, u.made[1], strict=True)
        lines = [f"{name} = {number(value)}  # {unit}" for (name, unit), value in named]
        above = "# As found; what is estimated is the height.\n" + "\n".join(lines) + "\n\n"
        k = (Param("k", u.unit, _usual(u.value, u.sigma)),)
        added = [f"k * {each}" for each in codes]
        if channel == "heading":
            function = heading_function("\n".join(added), u.formula, k)
        else:
            function = imu_function(_over_time(channel), "t", added, u.formula, k)
        return replace(_law(u, k, above + function), of_one_day=of_one_day)

    return law


def _over_time(channel: str) -> law_effect.Law:
    sensor, axis = divmod(law_effect.CHANNELS.index(channel), 3)
    return law_effect.Law(
        sensor, (axis,), False, DRIVERS["t"], grammar.formula([("line", ())]), (1.0,)
    )


# Code, names and units of the numbers of each course.
COURSES: Mapping[str, Callable[[Unnamed], Law]] = {
    "bump": _course(
        "np.exp(-0.5 * ((t - AT) / WIDTH) ** 2)", (("AT", "s"), ("WIDTH", "s")),
        of_one_day=True, moment=1,
    ),
    "while": _course(
        "((t >= FIRST) & (t <= LAST))", (("FIRST", "s"), ("LAST", "s")),
        of_one_day=True, moment=2,
    ),
    "swing": _course(
        "np.sin(2.0 * np.pi * t / PERIOD + PHASE)", (("PERIOD", "s"), ("PHASE", "rad")),
        of_one_day=True,
    ),
    "switched": _course(
        "((t - START) % PERIOD < LENGTH)", (("PERIOD", "s"), ("START", "s"), ("LENGTH", "s")),
        of_one_day=True,
    ),
    "saw": _course(
        "(((t - START) / PERIOD) % 1.0 - 0.5)", (("PERIOD", "s"), ("START", "s")), of_one_day=True
    ),
    "fade": _course(
        "(t >= AT) * np.exp(-np.maximum(t - AT, 0.0) / TAU)", (("AT", "s"), ("TAU", "s")),
        of_one_day=True, moment=1,
    ),
    "chirp": _course(
        "np.sin(2.0 * np.pi * (FIRST + 0.5 * RATE * t) * t + PHASE)",
        (("FIRST", "Hz"), ("RATE", "Hz/s"), ("PHASE", "rad")), of_one_day=True,
    ),
    "ring": _course(
        "np.exp(-t / TAU) * np.sin(2.0 * np.pi * t / PERIOD + PHASE)",
        (("TAU", "s"), ("PERIOD", "s"), ("PHASE", "rad")),
    ),
    "decay": _course("np.exp(-t / TAU)", (("TAU", "s"),)),
    "lobe": _course(
        "np.exp(SHARPNESS * (np.cos(yaw - AT) - 1.0))", (("AT", "rad"), ("SHARPNESS", "1"))
    ),
}  # fmt: skip


def _law(u: Unnamed, parameters: tuple[Param, ...], code: str) -> Law:
    channel, _, what = u.formula.partition(" += ")
    if u.coefficients:
        what = f"k * {what}: the curve in this file, as found where k is one"
    words = u.story or f"{channel} reads too much by {what}."
    return Law(
        title=f"Law of {u.formula.replace(' += ', ': ')}",
        story=f"{words} (To be edited: say here in plain words what does that.)",
        motion="Any." if u.drivers == ("t",) else f"One that changes {', '.join(u.drivers)} much.",
        parameters=parameters,
        code=code,
    )


def _found(u: Unnamed, parameters: Sequence[Param]) -> tuple[Param, ...]:
    """The constants of a formula, with what was found as their usual sizes."""
    found = {p.name: _usual(p.value, p.sigma) for p in u.constants}
    return tuple(replace(p, prior_sigma=found[p.name]) for p in parameters)


def _scales(axes: str = "") -> tuple[Param, ...]:
    """What curves are multiplied by: one of all, or one for each axis."""
    names = [f"k_{a}" for a in axes] or ["k"]
    return tuple(Param(name, "1", 1.0) for name in names)


def _usual(value: float, sigma: float) -> float:
    """The prior of a constant of which this was found: the root mean square of what it may be, to
    two digits. A recording of the same device will show as much, another device of its kind
    something of that order."""
    return float(f"{math.hypot(value, sigma):.2g}")


# --- the file ------------------------------------------------------------------------------------

_FILE = '''"""{about}"""

from __future__ import annotations
{imports}
{code}

EFFECT = Effect(
    id="{id}",
    title={title},
    # (one sigma is the size found: this device shows as much in another recording, another of its
    # kind something of that order)
    parameters=({parameters}),
    story={story},
    source={source},
    motion={motion},
    validated={validated},
{acts}
)
'''


def text_of(
    law: Law, effect_id: str, found_in: str, gain: float, by: str = "handcal explain"
) -> str:
    """The file; found_in: names of recordings; gain: nats that the law gains there; by: the command
    that found it."""
    acts = ["imu_error=imu_error,"]
    if law.of_past:
        acts = ['seen={"heading": heading},']
    if law.of_heading:
        acts = ['observation_error={"heading": residual_function(_heading, kept=False)},']
    if law.needs:
        acts.append(f"needs=({', '.join(json.dumps(n) for n in law.needs)},),")
    acts += ["of_one_day=True,"] * law.of_one_day
    # (names of files are anybody's: they stand in literals only, since this text will be run)
    return _FILE.format(
        about="\n".join(wrapped(f"{law.title}.")),
        imports=_imports(law),
        code=law.code,
        id=effect_id,
        title=_quoted(law.title),
        parameters=_params(law.parameters),
        story=_quoted(law.story),
        source=_quoted(f"found in {found_in} by {by}"),
        motion=_quoted(law.motion),
        validated=_quoted(f"the recording in which it was found: {gain:.0f} nats"),
        acts="\n".join(f"    {line}" for line in acts),
    )


def _imports(law: Law) -> str:
    """What the code needs, in the order of an import sorter."""
    typing = "\nfrom typing import Any\n" * law.of_heading
    numpy = "\nimport numpy as np\n" * ("np." in law.code)
    numpy += "from scipy.interpolate import CubicSpline\n" * ("CubicSpline(" in law.code)
    if law.of_heading:
        time = "".join(f"{name}, " for name in ("TIME", "WARMTH") if f"[{name}]" in law.code)
        own = "from handcal.compiled.jit import residual_function\n"
        own += f"from handcal.effects import {time}Effect, Param\n"
    else:
        own = (
            "from handcal.effects import Effect, Param, Signals\nfrom handcal.types import Array\n"
        )
    return f"{typing}{numpy}\n{own}"


def _params(parameters: Sequence[Param]) -> str:
    if len(parameters) == 1:
        return f"{_param(parameters[0])},"
    return "\n" + "".join(f"        {_param(p)},\n" for p in parameters) + "    "


def _param(p: Param) -> str:
    more = ", positive=True" if p.positive else ""
    return f"Param({json.dumps(p.name)}, {json.dumps(p.unit)}, {p.prior_sigma!r}{more})"


def _quoted(text: str) -> str:
    """A text as a literal, over several lines where it is long."""
    lines = textwrap.wrap(text, WIDE - 12, drop_whitespace=False, break_long_words=False)
    parts = [json.dumps(line, ensure_ascii=False) for line in lines or [""]]
    return "\n    ".join(parts)


def write(
    unnamed: Sequence[Unnamed], path: Path, recordings: Sequence[str], taken: Collection[str]
) -> list[Path]:
    """Write each law as a file: FILE.py, FILE_2.py and so on, the file's name being the effect's
    id. taken: ids that there are; neither those nor files that exist are used. recordings: names.
    """
    written: list[Path] = []
    number = 1
    for u in unnamed:
        target = path
        while target.exists() or target.stem in taken:
            number += 1
            target = path.with_stem(f"{path.stem}_{number}")
        text = text_of(law_of(u), target.stem, ", ".join(recordings), u.log_evidence_gain)
        output.write_bytes(target, text.encode("utf-8", errors="backslashreplace"))
        written.append(target)
    return written
