"""The command ``export``. What is slow to import is imported where it is used."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from handcal.commands._options import (
    AS_IT_IS,
    Anyway,
    Reading,
    load,
    reads_recordings,
    with_own_effects,
)
from handcal.commands._registry import say, tell


class Readings(StrEnum):
    """What a vehicle had done to the readings of a recording."""

    raw = "raw"
    corrected = "corrected"


VEHICLE = ("flu", "frd")  # what the recording's axes are on a vehicle
# What the header's lines begin with that are said in the terminal as well.
SAID = (
    "Nothing was calibrated",
    "Of the gyro",
    "Of the accelerometer",
    "Not in this file",
    "The biases were found",
    "All of that",
    "How much",
    "Warning: ",
)


@with_own_effects
@reads_recordings
def export(
    result: Annotated[
        Path | None,
        typer.Argument(
            metavar="RESULT.json",
            help="Result of calibrate, explain or lab with --json; of allan for the noise alone.",
        ),
    ] = None,
    to: Annotated[
        str, typer.Option(metavar="FORMAT", help="Format to write; list shows them all.")
    ] = "list",
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="File to write; - for standard output."),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Recording on which to measure what the format cannot hold."
        ),
    ] = None,
    noise: Annotated[
        Path | None,
        typer.Option(
            metavar="ALLAN.json", help="Noise of the device at rest: a result of `allan --json`."
        ),
    ] = None,
    axes: Annotated[
        list[str] | None,
        typer.Option(
            metavar="flu|frd|SENSOR=AXES",
            help="px4, ardupilot: the recording's x, y, z are forward, left, up (flu, the default) "
            "or forward, right, down (frd); and which axes of gyro, accel or mag stand for the "
            "IMU's x, y, z: mag=y,x,-z (repeatable).",
        ),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="px4, ardupilot: the vehicle's parameters when this was recorded, if the log "
            "does not hold them (.params, .param, mavlogdump's PARM table).",
        ),
    ] = None,
    readings: Annotated[
        Readings | None,
        typer.Option(
            help="px4, ardupilot: whether the readings of a table are raw, or corrected by the "
            "vehicle's own calibration. A log holds this itself."
        ),
    ] = None,
    instance: Annotated[
        list[str] | None,
        typer.Option(
            metavar="K|SENSOR=K",
            help="px4: index of the vehicle's sensor, if the recording does not hold it: 1 for "
            "CAL_GYRO1 and CAL_ACC1, or gyro=1 and accel=2 (repeatable).",
        ),
    ] = None,
    anyway: Anyway = False,
    how: Reading = AS_IT_IS,
) -> None:
    """Write a result in the format of another program.

    The header of the file says what it holds, what its format cannot hold, and how large that is.
    """
    from handcal import output
    from handcal.explain.model_file import laws_of
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
    vehicle, how = _axes(axes or [], how)
    given = None if recording is None else load(recording, how)
    topic = how.topics.get("imu")
    with laws_of(str(result), _read(result)):
        made = contents(
            result, form, given, noise, topic, vehicle, parameters,
            readings=readings or "", instance=_instance(instance or []), anyway=anyway,
        )  # fmt: skip
        text = form.write(made)
    if str(out) == output.STANDARD_OUTPUT:
        print(text, end="")
        return
    output.write_text(out, text)
    for line in [line for line in made.header if line.startswith(SAID)] + [*form.says(made)]:
        say(line)
    tell(f"{out}: {form.line}")


def _read(result: Path) -> Any:
    """Of a result, its JSON. Errors: InputError, for a recording with what makes a result of it."""
    from handcal.documents import read_json
    from handcal.recordings.inputs import format_of
    from handcal.types import InputError

    try:
        return read_json(result)
    except InputError as error:
        refused = error
    try:
        kind = format_of(result).UNDERSTOOD
    except InputError:
        raise refused from None
    command = shlex.join(["handcal", "explain", str(result), "--json", f"{result.stem}.json"])
    raise InputError(f"{result} is a recording ({kind}), not a result. To make a result: {command}")


def _instance(words: Sequence[str]) -> dict[str, int]:
    """By sensor. Errors: InputError."""
    from handcal.recordings.inputs._options import HALVES
    from handcal.types import InputError

    out = dict[str, int]()
    for word in words:
        sensor, _, number = word.rpartition("=")
        if sensor not in ("", *HALVES) or not (number.isascii() and number.isdigit()):
            raise InputError(f"--instance {word}: expected 1, or gyro=1 and accel=2.")
        out |= dict.fromkeys([sensor] if sensor else HALVES, int(number))
    return out


def _axes(words: Sequence[str], how: Reading) -> tuple[str | None, Reading]:
    """Of --axes, what is of the vehicle and what is of the file. Errors: InputError."""
    from handcal.types import InputError

    of_file = [word for word in words if "=" in word]
    others = [word for word in words if "=" not in word]
    if len(others) > 1 or not set(others) <= set(VEHICLE):
        raise InputError(f"--axes {' '.join(others)}: expected flu, frd, or mag=y,x,-z.")
    return others[0] if others else None, replace(how, axes=of_file)
