"""The command ``lab size``. What is slow to import is imported where it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from handcal.commands._options import Height, Json, Latitude, Report, Topics, Units, load
from handcal.commands._progress import progress
from handcal.commands.lab._gravity import Gravity, gravity_of


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
    from handcal.output import check_outputs
    from handcal.show.calibration.summary import write_json
    from handcal.show.lab.sheet import print_sheet, write_sheet
    from handcal.show.lab.size import size_json, size_sheet

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
        from handcal.show.terminal import Terminal

        print_sheet(size_sheet(result, file.name, pictures=False), Terminal())
