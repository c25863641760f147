"""CSV: the table of parameters with sigmas and units, all digits; lines that begin with # are the
header."""

from __future__ import annotations

import csv
import io

from handcal.exports import Contents, Format
from handcal.exports._table import HEAD, rows

# A word that a spreadsheet would take for a formula.
FORMULA = ("=", "+", "-", "@")


def _word(text: str) -> str:
    return f"'{text}" if text.startswith(FORMULA) else text


def write(contents: Contents) -> str:
    """The table."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(HEAD)
    for effect, name, value, sigma, *words in rows(contents):
        table.writerow([_word(effect), _word(name), value, sigma, *map(_word, words)])
    return contents.commented() + out.getvalue()


FORMAT = Format(
    program="a table of numbers (CSV)",
    line="CSV: the parameters with sigmas and units",
    write=write,
    keep=None,
    notes=("Signs: a sensor reads truth plus error, so a bias of +0.1 reads 0.1 too much; SI",),
)
