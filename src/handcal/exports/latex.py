"""LaTeX: the table of parameters as a ``tabular`` without packages, each to the second digit of its
sigma."""

from __future__ import annotations

import re

from handcal.exports import Contents, Format
from handcal.exports._table import rows, short


def _text(words: str) -> str:
    return re.sub(r"([_%&#$])", r"\\\1", words)


def _unit(unit: str) -> str:
    return "" if unit == "1" else re.sub(r"\^(\w+)", r"$^{\1}$", _text(unit))


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
