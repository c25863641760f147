"""The command ``lab size``. What is slow to import is imported where it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from handcal.commands._options import (
    AS_IT_IS,
    Height,
    Json,
    Latitude,
    Reading,
    Report,
    load,
    reads_recordings,
)
from handcal.commands._progress import progress
from handcal.commands.lab._gravity import Gravity, gravity_of
from handcal.commands.lab._results import write_results


@reads_recordings
def size(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A recording of steady spins, or of fast turns with /reference; or a CSV file as "
            "for known-input: one row a test, with wx wy wz, fx fy fz (known), ax ay az (read).",
        ),
    ],
    gravity: Gravity = None,
    latitude: Latitude = None,
    height: Height = 0.0,
    how: Reading = AS_IT_IS,
    json: Json = None,
    report: Report = None,
) -> None:
    """Find where each of the three accelerometers sits, from fast turns.

    On a rate table: let the device rest, then spin it steadily about the vertical, in each of
    six attitudes in which a diagonal of a face points up. Without one: shake it with fast turns
    about all axes, a second IMU on the same body recording beside it (/reference).
    """
    from handcal.lab import size as method
    from handcal.lab import steady_tests_csv
    from handcal.output import check_outputs
    from handcal.show.lab.size import size_json, size_sheet

    g = gravity_of(gravity, latitude, height)
    check_outputs((json, report), (file,))
    table = file.suffix.lower() in (".csv", ".tsv")
    recording = None if table else load(file, how)
    with progress(f"calibrating {file.name}"):
        if recording is None:
            result = method.of_tests(steady_tests_csv.read(file, "ZXZ", g)[0])
        else:
            result = method.size(recording, g)
    write_results(
        lambda pictures: size_sheet(result, file.name, pictures),
        lambda: size_json(result, file),
        report,
        json,
    )
