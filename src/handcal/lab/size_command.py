"""The command ``lab size``. What is slow to import is imported where it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from handcal.cli import Height, Json, Latitude, Report, Topics, Units, load
from handcal.lab.gravity import Gravity, gravity_of
from handcal.progress import progress


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
    topic: Topics = None,
    units: Units = None,
    json: Json = None,
    report: Report = None,
) -> None:
    """Find where each of the three accelerometers sits, from fast turns.

    On a rate table: let the device rest, then spin it steadily about the vertical, in each of
    six attitudes in which a diagonal of a face points up. Without one: shake it with fast turns
    about all axes, a second IMU on the same body recording beside it (/reference).
    """
    from handcal.lab import bench_csv
    from handcal.lab import size as method
    from handcal.lab.sheet import print_sheet, write_sheet
    from handcal.lab.size_show import size_json, size_sheet
    from handcal.output import check_outputs
    from handcal.summary import write_json

    g = gravity_of(gravity, latitude, height)
    check_outputs((json, report), (file,))
    table = file.suffix.lower() in (".csv", ".tsv")
    recording = None if table else load(file, topic, units)
    with progress(f"calibrating {file.name}"):
        if recording is None:
            result = method.of_tests(bench_csv.read(file, "ZXZ", g)[0])
        else:
            result = method.size(recording, g)
    if report:
        write_sheet(size_sheet(result, file.name, pictures=True), report)
    if json:
        write_json(size_json(result, file), json)
    if str(json) != "-":
        from rich.console import Console

        print_sheet(size_sheet(result, file.name, pictures=False), Console())
