"""Markdown: the table of parameters, each to the second digit of its sigma."""

from __future__ import annotations

from handcal.exports import Contents, Format
from handcal.exports._table import rows, short


def write(contents: Contents) -> str:
    """The table, the header behind it."""
    lines = ["| parameter | value | ± 1 sigma | unit | observable |", "|---|---:|---:|---|---|"]
    for effect, name, value, sigma, unit, seen, of in rows(contents):
        shown = " ".join((f"`{effect}` {name}", *([f"({of})"] if of else [])))
        lines.append(f"| {shown} | {' | '.join(short(value, sigma))} | {unit} | {seen} |")
    said = "".join(f"- {line}\n" for line in contents.header)
    return "\n".join(lines) + "\n\n" + said


FORMAT = Format(
    program="a page (Markdown)",
    line="Markdown: the parameters with sigmas and units",
    write=write,
    keep=None,
    notes=("Signs: a sensor reads truth plus error, so a bias of +0.1 reads 0.1 too much; SI",),
)
