"""The command ``lab thermal``. What is slow to import is imported where it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from handcal.cli import Height, Json, Latitude, Report, Topics, Units, load
from handcal.lab.gravity import Gravity, gravity_of
from handcal.progress import progress


def thermal(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="Recordings of one device with /temperature, mostly at rest."
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
    """Find how biases and scale factors change with temperature.

    Let the device rest while it warms up or cools down (a ramp), or at several temperatures one
    after the other (a soak), each time on many sides if the accelerometer's scale is wanted too.
    With /reference, steady turns show the gyro's scale.
    """
    from handcal.lab import thermal as method
    from handcal.lab.sheet import print_sheet, write_sheet
    from handcal.lab.thermal_show import files_title, thermal_json, thermal_sheet
    from handcal.output import check_outputs
    from handcal.summary import write_json

    g = gravity_of(gravity, latitude, height)
    check_outputs((json, report), files)
    recordings = [load(file, topic, units) for file in files]
    with progress("fitting curves") as bar:
        result = method.thermal(recordings, g, bar)
    name = files_title(files)
    if report:
        write_sheet(thermal_sheet(result, name, pictures=True), report)
    if json:
        write_json(thermal_json(result), json)
    if str(json) != "-":
        from rich.console import Console

        print_sheet(thermal_sheet(result, name, pictures=False), Console())
