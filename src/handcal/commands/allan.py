"""The command ``allan``. What is slow to import is imported where it is used."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from handcal.commands._options import (
    AS_IT_IS,
    Json,
    Reading,
    Report,
    in_units,
    load,
    reads_recordings,
)
from handcal.commands._progress import progress


@in_units
@reads_recordings
def allan(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recording with a long rest: hours are best.")
    ],
    span: Annotated[
        str | None,
        typer.Option(
            metavar="FROM,TO", help="Interval to analyse, s; the longest rest if not given."
        ),
    ] = None,
    how: Reading = AS_IT_IS,
    json: Json = None,
    report: Report = None,
) -> None:
    """Noise of a device at rest: Allan deviation, its terms, and noise levels for the filter."""
    from handcal.allan.analysis import analyse
    from handcal.output import check_outputs
    from handcal.show.allan import allan_json, print_allan, write_allan_report
    from handcal.show.calibration.summary import write_json

    check_outputs((json, report), (file,))
    chosen = _span(span)
    recording = load(file, how, needs=())
    with progress(f"analysing {file.name}"):
        result = analyse(recording, chosen)
    if report:
        write_allan_report(result, report)
    if json:
        write_json(allan_json(result), json)
    if str(json) != "-":
        from handcal.show.console import Terminal

        print_allan(result, Terminal())


def _span(text: str | None) -> tuple[float, float] | None:
    """FROM,TO as typed. Errors: InputError."""
    from handcal.types import InputError

    if text is None:
        return None
    try:
        start, end = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--span {text}: expected FROM,TO in seconds, as 10,3600.") from None
    if not (math.isfinite(start) and math.isfinite(end)):
        raise InputError(f"--span {text}: expected finite numbers.")
    return start, end
