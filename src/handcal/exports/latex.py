"""LaTeX: the table of parameters as a ``tabular`` without packages, each to the second digit of its
sigma."""

from __future__ import annotations

import re

from handcal.exports import Contents, Format
from handcal.exports._table import rows, short

# What TeX reads as a command, and how it is written to be read.
SIGNS = {"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
         **{c: f"\\{c}" for c in "_%&#${}"}}  # fmt: skip


def _text(words: str) -> str:
    return "".join(SIGNS.get(c, c) for c in words)


def _unit(unit: str) -> str:
    """A unit with its powers raised."""
    parts = re.split(r"\^(\w+)", unit)
    powers = (f"$^{{{_text(p)}}}$" for p in parts[1::2])
    return (
        ""
        if unit == "1"
        else "".join(a + b for a, b in zip(map(_text, parts[::2]), [*powers, ""], strict=True))
    )


def write(contents: Contents) -> str:
    """The table."""
    lines = [r"\begin{tabular}{llrrl}", r"\hline",
             r"effect & parameter & value & $\sigma$ & unit \\", r"\hline"]  # fmt: skip
    for effect, name, value, sigma, unit, _, of in rows(contents):
        numbers = [f"${v}$" if v else "" for v in short(value, sigma)]
        named = _text(f"{name} ({of})" if of else name)
        lines.append(f"{_text(effect)} & {named} & {' & '.join(numbers)} & {_unit(unit)} \\\\")
    lines += [r"\hline", r"\end{tabular}"]
    return contents.commented("% ") + "\n".join(lines) + "\n"


FORMAT = Format(
    program="a paper (LaTeX)",
    line="LaTeX: the parameters with sigmas and units, as a tabular",
    write=write,
    keep=None,
    notes=("Signs: a sensor reads truth plus error, so a bias of +0.1 reads 0.1 too much; SI",),
)
