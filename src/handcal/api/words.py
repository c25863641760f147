"""What the command line says of its options, in Python's words."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from handcal.recordings.inputs._options import si, unit_factor
from handcal.types import HandcalError

_UNIT = r"--units (\w+)=(\.\.\.|[^\s;),:]+?)(?=\.?(?:[\s;),:]|$))"
_SEVERAL = r"(\w+=[^\s;),:]+?(?:,\w+=[^\s;),:]+?)*)(?=[.,]?(?:[\s;),:]|$))"


def _mapping(pairs: str) -> str:
    """``accel=g,gyro=deg/s`` as a dict is written."""
    said = ", ".join('"{}": "{}"'.format(*pair.split("=", 1)) for pair in pairs.split(","))
    return f"{{{said}}}"


_IN_PYTHON = (
    (r"--units (\w+)=\.\.\.", r'units={"\1": ...}'),
    (rf"--units {_SEVERAL}", lambda m: f"units={_mapping(m[1])}"),
    (r"--axes (\w+)=((?:-?[xyz],){2}-?[xyz])", r'axes={"\1": "\2"}'),
    (r"--columns ([^\s;:)]+?)(?=\.?(?:[\s;:)]|$))", r'columns="\1"'),
    (r"--rate HZ", "rate_hz=HZ"),
    (r"--rate\b", "rate_hz"),
    (r"--(axes|columns)\b", r"\1"),
    (r"--units\b", "units"),
    (r"--topic (\w+)=\.\.\.", r'topics={"\1": ...}'),
    (r"--topic (\w+)=([^\s;:]+?)(?=[.:]?(?:[\s;:]|$))", r'topics={"\1": "\2"}'),
    (r"--effects-from ([^\s:]+):", r'effects_from("\1"):'),
    (r"(?:say )?--effects-from with its folder",
     "do this within `with handcal.effects_from(folder):`"),
    (r"come with --effects-from", "come with handcal.effects_from(folder)"),
    (r"--span FROM,TO", "span=(from, to)"),
    (r"--span ([^\s:]+),([^\s:]+):", r"span=(\1, \2):"),
    (r"--assume ([\w-]+)", r'assume="\1"'),
    (r"--(anyway|biases|reference-exact)\b", lambda m: m[1].replace("-", "_") + "=True"),
    (r"missing from --effects", "missing from the list of effects"),
    (r"--(effects|budget)\b", r"\1"),
    (r"handcal explain tries", "handcal.explain tries"),
)  # fmt: skip


def in_python(text: str) -> str:
    """A sentence of the command line, as it is said where the call came from Python."""
    for pattern, said in _IN_PYTHON:
        text = re.sub(pattern, said, text)
    return text


def of_arrays(text: str) -> str:
    """The same where arrays were given, which are in SI."""
    text = re.sub(rf"give {_UNIT}", _converted, text)
    text = re.sub(r"name its unit with --units \w+=\.\.\.", "convert it to SI.", text)
    return in_python(re.sub(r" \(--units \w+=[^)]+\)", "", text))


def _converted(unit: re.Match[str]) -> str:
    return f"multiply it by {unit_factor(unit[1], unit[2]) / unit_factor(unit[1], si(unit[1])):.6g}"


@contextmanager
def spoken(arrays: bool = False) -> Iterator[None]:
    """Inside, errors are said in Python's words."""
    try:
        yield
    except HandcalError as error:
        error.args = ((of_arrays if arrays else in_python)(str(error)),)
        raise
