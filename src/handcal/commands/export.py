"""The command ``export``. What is slow to import is imported where it is used."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from handcal.commands._options import Topics, Units, load, with_own_effects
from handcal.commands._registry import say, tell

# What the header's lines begin with that are said in the terminal as well.
SAID = ("Nothing was calibrated", "Not in this file", "All of that", "How much", "Warning: ")


class Axes(StrEnum):
    """What the recording's axes are on a vehicle."""

    flu = "flu"
    frd = "frd"


@with_own_effects
def export(
    result: Annotated[
        Path | None,
        typer.Argument(
            metavar="RESULT.json", help="What calibrate, explain or lab wrote with --json."
        ),
    ] = None,
    to: Annotated[
        str, typer.Option(metavar="FORMAT", help="Format to write; list shows them all.")
    ] = "list",
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="File to write; - for output."),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Measure on this recording what the format cannot hold."),
    ] = None,
    noise: Annotated[
        Path | None,
        typer.Option(metavar="ALLAN.json", help="Noise of the device at rest, by allan --json."),
    ] = None,
    axes: Annotated[
        Axes | None,
        typer.Option(
            help="px4, ardupilot: the recording's x, y, z are forward, left, up (flu) or forward, "
            "right, down (frd). Default: flu."
        ),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="px4, ardupilot: the vehicle's parameters when this was recorded, if the log "
            "does not say them (.params, .param, mavlogdump's PARM table).",
        ),
    ] = None,
    topic: Topics = None,
    units: Units = None,
) -> None:
    """Write a result in the format of another program.

    The file's header says what is in it, and what the format cannot hold and how much that leaves.
    """
    from handcal import output
    from handcal.exports import format_of, formats
    from handcal.exports._contents import contents
    from handcal.types import InputError

    if to.casefold() == "list":
        # (said without a word of what was asked for, that would look like success)
        if out is not None:
            raise InputError("export needs --to FORMAT; 'handcal export' alone lists the formats.")
        width = max(map(len, formats()))
        for name, form in formats().items():
            print(f"{name:<{width}}  {form.line}")
        return
    form = format_of(to)
    if result is None or out is None:
        raise InputError(f"export --to {to} needs RESULT.json and -o FILE.")
    output.check_outputs((out,), (result, recording, noise, parameters))
    given = None if recording is None else load(recording, topic, units)
    named = dict(pair.partition("=")[::2] for pair in topic or [])
    made = contents(result, form, given, noise, named.get("imu"), axes and str(axes), parameters)
    text = form.write(made)
    if str(out) == output.STANDARD_OUTPUT:
        print(text, end="")
        return
    output.write_text(out, text)
    for line in made.header:
        if line.startswith(SAID):
            say(line)
    tell(f"{out}: {form.line}")
