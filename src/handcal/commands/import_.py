"""The command ``import``. What is slow to import is imported where it is used."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handcal.commands._options import AS_IT_IS, Reading, load, reads_recordings
from handcal.commands._registry import say, tell

if TYPE_CHECKING:
    pass


@reads_recordings
def import_(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="A phone log or any other format.")
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FILE.mcap", help="Recording to write.")
    ],
    how: Reading = AS_IT_IS,
) -> None:
    """Turn a phone log or another format into an MCAP recording."""
    from handcal.output import check_outputs
    from handcal.recordings.export import check_ending, write_mcap

    check_outputs((out,), (source,))
    check_ending(out)
    recording = load(source, how)
    write_mcap(recording, out)
    for warning in recording.warnings:
        say(warning)
    streams = ", ".join(["imu", *recording.streams])
    tell(f"{out}: {recording.duration_s:.1f} s at {recording.rate_hz:.0f} Hz, {streams}")
