"""The command ``lab scalar``. What is slow to import is imported where it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from handcal.cli import Height, Json, Latitude, Report, Topics, Units, check_folders, load, radians
from handcal.progress import progress


def scalar(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recording with rests in many attitudes.")
    ],
    effects: Annotated[
        str,
        typer.Option(metavar="ID,...", help="Effects to estimate beyond constant biases."),
    ] = "accel_scale,accel_misalignment,gyro_scale,gyro_misalignment",
    gravity: Annotated[
        float | None, typer.Option(metavar="M/S^2", help="Gravity here; 9.80665 if not given.")
    ] = None,
    latitude: Latitude = None,
    height: Height = 0.0,
    topic: Topics = None,
    units: Units = None,
    json: Json = None,
    report: Report = None,
) -> None:
    """Calibrate against the size of gravity alone: rests in many attitudes, and turns between.

    No equipment is needed. Let the device lie still for some seconds in each of a dozen
    attitudes, on sides, edges and slants, and turn it about all axes in between.
    """
    from handcal.lab.scalar import halves_or_none, scalar
    from handcal.lab.scalar_show import scalar_json, scalar_sheet
    from handcal.lab.sheet import print_sheet, write_sheet
    from handcal.summary import write_json

    g = _gravity(gravity, latitude, height)
    check_folders(json, report)
    recording = load(file, topic, units)
    ids = tuple(e.strip() for e in effects.split(",") if e.strip())
    with progress(f"calibrating {file.name}"):
        result = scalar(recording, ids, g)
        halves = halves_or_none(result)
    if report:
        write_sheet(scalar_sheet(result, halves, pictures=True), report)
    if json:
        write_json(scalar_json(result, halves), json)
    if str(json) != "-":
        from rich.console import Console

        print_sheet(scalar_sheet(result, halves, pictures=False), Console())


def _gravity(gravity: float | None, latitude: float | None, height: float) -> float:
    """m/s^2 as typed, or at the latitude. Errors: InputError."""
    import math

    from handcal.earth import STANDARD_GRAVITY, local_earth
    from handcal.types import InputError

    if gravity is not None and latitude is not None:
        raise InputError("--gravity and --latitude say the same: give one of them.")
    if gravity is not None:
        if not 9.7 < gravity < 9.9:
            raise InputError(f"--gravity {gravity:g}: on the Earth it lies between 9.7 and 9.9.")
        return gravity
    if latitude is None:
        return STANDARD_GRAVITY
    if not math.isfinite(latitude):
        raise InputError(f"--latitude {latitude}: expected a finite number.")
    return -float(local_earth(radians(latitude), height)[0][2])
