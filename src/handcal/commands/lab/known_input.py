"""The command ``lab known-input``. What is slow to import is imported where it is used."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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

if TYPE_CHECKING:
    from handcal.lab.known_input import KnownInput
    from handcal.lab.steady_tests import Bench
    from handcal.lab.table import Table
    from handcal.show.lab.known_input import TableErrors


# A gyro that was never turned faster than this (rad/s) is asked for its bias alone.
LEAST_RATE = 0.02


class Axes(StrEnum):
    """Whose axes the result is in."""

    imu = "imu"
    table = "table"


@with_own_effects
@reads_recordings
def known_input(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A recording with /reference, or a CSV file: one row a test, with columns wx wy "
            "wz (known rate), fx fy fz (known force) or alpha beta gamma (angles of the table), "
            "gx gy gz and ax ay az (averaged readings), temp; units in brackets, as gx (deg/s).",
        ),
    ],
    effects: Annotated[
        str | None,
        typer.Option(
            metavar="ID,...",
            help="Effects to estimate beyond constant biases. If not given: scale and "
            "misalignment of each sensor, of the gyro only if it was turned.",
        ),
    ] = None,
    axes: Annotated[
        Axes,
        typer.Option(
            help="Body axes. imu: x is the accelerometer's x, and the mounting of the IMU is "
            "estimated; table: the table's axes, to which all misalignments refer."
        ),
    ] = Axes.imu,
    sequence: Annotated[
        str,
        typer.Option(
            metavar="XYZ", help="Axes of the rotations alpha, beta, gamma; the frame n has z up."
        ),
    ] = "ZXZ",
    angle_sigma: Annotated[
        float,
        typer.Option(
            metavar="ARCSEC", min=0.0, help="Angle error of each axis in each pose, 1 sigma."
        ),
    ] = 0.0,
    tilt_sigma: Annotated[
        float, typer.Option(metavar="ARCMIN", min=0.0, help="Tilt of the table's base, 1 sigma.")
    ] = 0.0,
    gravity: Gravity = None,
    latitude: Latitude = None,
    height: Height = 0.0,
    how: Reading = AS_IT_IS,
    json: Json = None,
    report: Report = None,
) -> None:
    """Calibrate against a turntable, a dividing head or a trusted IMU on the same body.

    Rests and steady turns are found in the recording, or are the rows of a CSV table. Parameters
    that the tests cannot separate are listed before the fit.
    """
    from handcal.lab import steady_tests, steady_tests_csv
    from handcal.lab.known_input import known_input
    from handcal.output import check_outputs
    from handcal.show.lab.known_input import known_input_json, known_input_sheet
    from handcal.types import InputError

    g = gravity_of(gravity, latitude, height)
    check_outputs((json, report), (file,))
    recording, poses = None, None
    if file.suffix.lower() in (".csv", ".tsv"):
        tests, poses = steady_tests_csv.read(file, sequence, g)
    else:
        recording = load(file, how)
    if (angle_sigma or tilt_sigma) and poses is None:
        raise InputError("--angle-sigma and --tilt-sigma need the angles of the table (CSV).")
    with progress(f"calibrating {file.name}"):
        if recording is not None:
            tests = steady_tests.of_recording(recording)
        result = known_input(tests, _effects(effects, tests), axes.value)
        errors = None
        if poses is not None and (angle_sigma or tilt_sigma):
            errors = _table_errors(result, poses, angle_sigma, tilt_sigma)
    write_results(
        lambda pictures: known_input_sheet(result, file.name, errors, pictures),
        lambda: known_input_json(result, file, recording, errors),
        report,
        json,
    )


def _effects(typed: str | None, tests: Bench) -> tuple[str, ...]:
    """As typed, or scale and misalignment of what was read; of a gyro only if it was turned."""
    import numpy as np

    from handcal.lab.known_input import DEFAULT

    if typed is not None:
        return comma_separated(typed)
    fastest = float(np.abs(tests.mean(tests.truth.gyro)).max())
    known = {"gyro": tests.used[0] and fastest > LEAST_RATE, "accel": bool(tests.used[3])}
    return tuple(e for e in DEFAULT if known[e.split("_")[0]])


def _table_errors(
    result: KnownInput, poses: Table, angle_sigma: float, tilt_sigma: float
) -> TableErrors:
    import numpy as np

    from handcal.lab.table import ARCMIN, ARCSEC, error_covariance
    from handcal.show.lab.known_input import TableErrors

    kept, alone = (
        np.sqrt(np.diag(error_covariance(
            result, poses, angle_sigma * ARCSEC, tilt_sigma * ARCMIN, keep)))
        for keep in (True, False)
    )  # fmt: skip
    said = f"{angle_sigma:g} arcsec an axis, {tilt_sigma:g} arcmin of the base"
    return TableErrors(kept, alone, said)
