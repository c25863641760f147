"""Markdown: the table of parameters, each to the second digit of its sigma."""

from __future__ import annotations

import html

from handcal.exports import Contents, Format
from handcal.exports._table import rows, short


def _cell(text: str) -> str:
    return html.escape(text, quote=False).replace("|", r"\|")


def write(contents: Contents) -> str:
    """The table, the header behind it."""
    lines = ["| parameter | value | ± 1 sigma | unit | shown |", "|---|---:|---:|---|---|"]
    for effect, name, value, sigma, unit, seen, of in rows(contents):
        shown = " ".join((f"`{effect}` {name}", *([f"({of})"] if of else [])))
        cells = (shown, *short(value, sigma), unit, seen)
        lines.append(f"| {' | '.join(map(_cell, cells))} |")
    said = "".join(f"- {html.escape(line, quote=False)}\n" for line in contents.header)
    return "\n".join(lines) + "\n\n" + said


FORMAT = Format(
    program="a page (Markdown)",
    line="Markdown: the parameters with sigmas and units",
    write=write,
    keep=None,
    notes=("Signs: a sensor reads truth plus error, so a bias of +0.1 reads 0.1 too much; SI",),
)
