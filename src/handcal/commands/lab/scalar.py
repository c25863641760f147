"""The command ``lab scalar``. What is slow to import is imported where it is used."""

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
    comma_separated,
    load,
    reads_recordings,
    with_own_effects,
)
from handcal.commands._progress import progress
from handcal.commands.lab._gravity import Gravity, gravity_of
from handcal.commands.lab._results import write_results


@with_own_effects
@reads_recordings
def scalar(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recording with rests in many attitudes.")
    ],
    effects: Annotated[
        str | None,
        typer.Option(
            metavar="ID,...",
            help="Effects to estimate beyond constant biases; if not given, accel_scale, "
            "accel_misalignment, gyro_scale, gyro_misalignment, or those of the only sensor.",
        ),
    ] = None,
    gravity: Gravity = None,
    latitude: Latitude = None,
    height: Height = 0.0,
    how: Reading = AS_IT_IS,
    json: Json = None,
    report: Report = None,
) -> None:
    """Calibrate against the magnitude of gravity alone: rests in many attitudes, and turns between.

    No equipment is needed. Let the device lie still for some seconds in each of a dozen
    attitudes, on sides, edges and slants, and turn it about all axes in between. An accelerometer
    without a gyro is calibrated too.
    """
    from handcal.lab.scalar import halves_or_none, scalar
    from handcal.output import check_outputs
    from handcal.show.lab.scalar import scalar_json, scalar_sheet

    g = gravity_of(gravity, latitude, height)
    check_outputs((json, report), (file,))
    recording = load(file, how, needs=("accel",))
    ids = None if effects is None else comma_separated(effects)
    with progress(f"calibrating {file.name}"):
        result = scalar(recording, ids, g)
        halves = halves_or_none(result)
    write_results(
        lambda pictures: scalar_sheet(result, halves, pictures),
        lambda: scalar_json(result, halves),
        report,
        json,
    )
