"""A law without a name as a file of the catalogue, to be edited and read in again.

Two steps: ``law_of`` says what a file has to hold of something found, one function for each kind
of it (``WRITERS``; a product of signals is the rest), and ``text_of`` puts that into a file like
those in ``handcal.effects``.
"""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from handcal.effects import Param
from handcal.explain.explanation import Unnamed
from handcal.explain.laws import CHANNELS
from handcal.types import HandcalError

# Columns of a line in a file that is to be read.
WIDE = 96


@dataclass(frozen=True)
class Law:
    """What a file says of a law.

    title, story, motion: as of an ``Effect``; parameters: their priors are what was found. code:
    source of its constants and functions, among them ``imu_error`` or ``_heading``, a residual
    function; needs: streams; of_one_day: another day it is another.
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


# --- what a file holds ---------------------------------------------------------------------------


def law_of(u: Unnamed) -> Law:
    """What a file has to hold of an unnamed law. Raises HandcalError for a kind that none can."""
    writer = _term if u.made is None else WRITERS.get(u.made[0])
    if writer is None:
        raise HandcalError(f"{u.formula} cannot be written as an effect file yet.")
    return writer(u)


# A signal by the name it has in a formula, as code that makes it of ``signals``; and of a heading's
# residual function.
_SIGNAL = {
    **{f"omega_{a}": f"signals.gyro[:, {i}]" for i, a in enumerate("xyz")},
    **{f"f_{a}": f"signals.accel[:, {i}]" for i, a in enumerate("xyz")},
    **{f"alpha_{a}": f"np.gradient(signals.gyro[:, {i}], signals.t)" for i, a in enumerate("xyz")},
    "t": "signals.t - signals.t[0]",
    "T": "signals.temperature - 25.0",
}
_SEEN = {
    "yaw": "np.arctan2(nav[9], nav[6])",
    "sin_pitch_x": "nav[12]",
    "sin_pitch_y": "nav[13]",
    "cos_tilt": "nav[14]",
    "t": "z[TIME]",
}
_PYTHON = (
    (r"play\(([\d.e-]+) m/s\^2\) of (f_[xyz])", r"following(\2, \1)"),
    (r"\^", "**"),
    (r"\babs\(", "np.abs("),
    (r"\b(sin|cos)\(pitch of ([xy])\)", r"\1_pitch_\2"),
    (r"\b(sin|cos)\((\d+) yaw\)", r"np.\1(\2.0 * yaw)"),
    (r"\bsin\(tilt\)\*\*2", "(1.0 - cos_tilt**2)"),
)
_FOLLOWING = '''
def following(x: Array, half: float) -> Array:
    """What follows x (n,) with so much play to either side."""
    out, at = [], float(x[0])
    for now in x.tolist():
        at = min(max(at, now - half), now + half)
        out.append(at)
    return np.array(out)

'''


def _term(u: Unnamed) -> Law:
    """A product of signals."""
    product = u.formula.partition(" += k * ")[2]
    code = product
    for pattern, python in _PYTHON:
        code = re.sub(pattern, python, code)
    helper = _FOLLOWING if "following(" in code else ""
    return _one_constant(u, code, helper, positive=bool(helper))


_BUMP = "np.exp(-0.5 * ((t - AT) / WIDTH) ** 2)"
_WHILE = "((t >= FIRST) & (t <= LAST))"
_SWING = "np.sin(2.0 * np.pi * t / PERIOD + PHASE)"
_DECAY = "np.exp(-t / TAU)"
_LOBE = "np.exp(SHARPNESS * (np.cos(yaw - AT) - 1.0))"
# Names and units of a course's numbers.
_BUMP_NUMBERS = (("AT", "s"), ("WIDTH", "s"))
_WHILE_NUMBERS = (("FIRST", "s"), ("LAST", "s"))
_SWING_NUMBERS = (("PERIOD", "s"), ("PHASE", "rad"))
_LOBE_NUMBERS = (("AT", "rad"), ("SHARPNESS", "1"))


def _course(
    code: str, numbers: Sequence[tuple[str, str]], of_one_day: bool = False
) -> Callable[[Unnamed], Law]:
    """Courses over time or direction (``shapes``) whose numbers have these names."""

    def law(u: Unnamed) -> Law:
        assert u.made is not None
        named = zip(numbers, u.made[1], strict=True)
        constants = [f"{name} = {float(f'{value:.6g}')}  # {unit}" for (name, unit), value in named]
        above = "# As found; what is estimated is the height.\n" + "\n".join(constants) + "\n\n"
        return _one_constant(u, code, above, of_one_day=of_one_day)

    return law


WRITERS: Mapping[str, Callable[[Unnamed], Law]] = {
    "bump": _course(_BUMP, _BUMP_NUMBERS, of_one_day=True),
    "while": _course(_WHILE, _WHILE_NUMBERS, of_one_day=True),
    "swing": _course(_SWING, _SWING_NUMBERS, of_one_day=True),
    "decay": _course(_DECAY, (("TAU", "s"),)),
    "lobe": _course(_LOBE, _LOBE_NUMBERS),
}


def _one_constant(
    u: Unnamed, code: str, above: str = "", *, positive: bool = False, of_one_day: bool = False
) -> Law:
    """A law of one channel that is k times an expression of signals."""
    (channel,) = u.channels
    k = Param("k", u.unit, _usual(u.value, u.sigma), positive)
    function = heading_function if channel == "heading" else imu_function
    words = u.story or f"{channel} reads too much by {u.formula.partition(' += ')[2]}."
    return Law(
        title=u.formula.replace(" += ", ": "),
        story=f"{words} (To be edited: say here in plain words what does that.)",
        motion="Any." if u.drivers == ("t",) else f"One that changes {', '.join(u.drivers)} much.",
        parameters=(k,),
        code=f"{above}\n{function(channel, f'k * {code}', u.formula, (k,))}",
        needs=("temperature",) if re.search(r"\bT\b", code) else (),
        of_one_day=of_one_day,
    )


def _usual(value: float, sigma: float) -> float:
    """The prior of a constant of which this was found: its size, to two digits. A recording of the
    same device will show as much, another device of its kind something of that order."""
    size = abs(value) if value and math.isfinite(value) else abs(sigma)
    return float(f"{size:.2g}")


def imu_function(channel: str, code: str, formula: str, parameters: Sequence[Param]) -> str:
    """Source of ``imu_error``, which adds an expression of parameters and signals to a channel."""
    names = ", ".join(p.name for p in parameters) + "," * (len(parameters) == 1)
    lines = [f"({names}) = p", "error = np.zeros((len(signals.t), 6))"]
    signals = _used(_SIGNAL, code)
    if "T" in signals:
        lines += ["if signals.temperature is None:", "    return error"]
    lines += [f"{name} = {signals[name]}" for name in signals]
    lines += [f"error[:, {CHANNELS.index(channel)}] = {code}", "return error"]
    units = ", ".join(p.unit for p in parameters)
    says = f'"""``{formula}``; p ({len(parameters)},) {units}, result (n, 6)."""'
    return _defined("imu_error(p: Array, signals: Signals) -> Array", [*_wrapped(says), *lines])


def heading_function(channel: str, code: str, formula: str, parameters: Sequence[Param]) -> str:  # noqa: ARG001
    """Source of ``_heading``, which takes such an expression off the heading's residual."""
    seen = _used(_SEEN, code)
    lines = [f"{p.name} = p[{i}]" for i, p in enumerate(parameters)]
    lines += [f"{name} = {seen[name]}" for name in seen]
    lines += [f"r[0] -= {code}", "return 0"]
    says = f'"""``{formula}``, rad: the reading less what it errs by."""'
    head = "_heading(nav: Any, p: Any, z: Any, r: Any) -> int"
    return _defined(head + ":  # noqa: ARG001", [*_wrapped(says), *lines])


def _used(vocabulary: Mapping[str, str], code: str) -> dict[str, str]:
    return {name: how for name, how in vocabulary.items() if re.search(rf"\b{name}\b", code)}


def _defined(head: str, lines: Sequence[str]) -> str:
    head = head if ":  #" in head else head + ":"
    return f"def {head}\n" + "\n".join(f"    {line}" for line in lines) + "\n"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, WIDE - 4, break_long_words=False, break_on_hyphens=False)


# --- the file ------------------------------------------------------------------------------------

_FILE = '''"""{about}."""

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


def text_of(law: Law, effect_id: str, found_in: str, gain: float) -> str:
    """The file; found_in: names of recordings; gain: nats that the law gains there."""
    acts = ["imu_error=imu_error,"]
    if law.of_heading:
        acts = ['observation_error={"heading": residual_function(_heading, kept=False)},']
    if law.needs:
        acts.append(f"needs=({', '.join(json.dumps(n) for n in law.needs)},),")
    acts += ["of_one_day=True,"] * law.of_one_day
    # (names of files are anybody's: they stand in literals only, since this text will be run)
    return _FILE.format(
        about=law.title,
        imports=_imports(law),
        code=law.code,
        id=effect_id,
        title=_quoted(law.title),
        parameters=" ".join(f"{_param(p)}," for p in law.parameters),
        story=_quoted(law.story),
        source=_quoted(f"found in {found_in} by handcal explain"),
        motion=_quoted(law.motion),
        validated=_quoted(f"the recording in which it was found: {gain:.0f} nats"),
        acts="\n".join(f"    {line}" for line in acts),
    )


def _imports(law: Law) -> str:
    if not law.of_heading:
        return (
            "\nimport numpy as np\n\nfrom handcal.effects import Effect, Param, Signals\n"
            "from handcal.types import Array\n"
        )
    time = "TIME, " * ("TIME" in law.code)
    return (
        "\nfrom typing import Any\n"
        + "\nimport numpy as np\n" * ("np." in law.code)
        + "\nfrom handcal._jit import residual_function\n"
        + f"from handcal.effects import {time}Effect, Param\n"
    )


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
        target.write_text(text, encoding="utf-8", errors="backslashreplace")
        written.append(target)
    return written
