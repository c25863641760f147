"""The command ``lab thermal``. What is slow to import is imported where it is used."""

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
    how: Reading = AS_IT_IS,
    json: Json = None,
    report: Report = None,
) -> None:
    """Find how biases and scale factors change with temperature.

    Let the device rest while it warms up or cools down (a ramp), or at several temperatures one
    after the other (a soak), each time on many sides if the accelerometer's scale is wanted too.
    With /reference, steady turns show the gyro's scale.
    """
    from handcal.lab.thermal import curves as method
    from handcal.output import check_outputs
    from handcal.show.lab.thermal import files_title, thermal_json, thermal_sheet

    g = gravity_of(gravity, latitude, height)
    check_outputs((json, report), files)
    recordings = [load(file, how) for file in files]
    with progress("fitting curves") as bar:
        result = method.thermal(recordings, g, bar)
    name = files_title(files)
    write_results(
        lambda pictures: thermal_sheet(result, name, pictures),
        lambda: thermal_json(result),
        report,
        json,
    )
