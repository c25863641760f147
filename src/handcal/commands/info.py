"""The command ``info``. What is slow to import is imported where it is used."""

from __future__ import annotations

from dataclasses import replace
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


@in_units
@reads_recordings
def info(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recording, of any format, or its folder.")
    ],
    how: Reading = AS_IT_IS,
    json: Json = None,
    report: Report = None,
) -> None:
    """What a file holds: streams, rates, gaps, units, rests, turns, and the errors it can show."""
    from handcal.design.seen import seen
    from handcal.exports import refusals
    from handcal.lab.scalar import of_few_rests
    from handcal.output import check_outputs
    from handcal.recordings.inputs import format_of
    from handcal.recordings.overview import overview
    from handcal.show.calibration.summary import write_json
    from handcal.show.info import Info, info_json, print_info, write_info_report

    check_outputs((json, report), (file,))
    recording = load(file, how)
    recording = replace(recording, warnings=(*recording.warnings, *refusals(recording)))
    form, found = format_of(file), overview(recording)
    stated = recording.file_units or getattr(form, "UNITS", "SI")
    if how.units:
        stated += f"; overridden by --units {how.units}"
    result = Info(form.UNDERSTOOD, stated, found, seen(found), of_few_rests(recording))
    if report:
        write_info_report(result, report)
    if json:
        write_json(info_json(result), json)
    if str(json) != "-":
        from handcal.show.console import Terminal

        print_info(result, Terminal())
