"""CSV: the table of parameters with sigmas and units, all digits; lines that begin with # are the
header."""

from __future__ import annotations

import csv
import io

from handcal.exports import Contents, Format
from handcal.exports._table import HEAD, rows


def write(contents: Contents) -> str:
    """The table."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(HEAD)
    table.writerows(rows(contents))
    return contents.commented() + out.getvalue()


FORMAT = Format(
    program="a table of numbers (CSV)",
    line="CSV: the parameters with sigmas and units",
    write=write,
    keep=None,
    notes=("Signs: a sensor reads truth plus error, so a bias of +0.1 reads 0.1 too much; SI",),
)
