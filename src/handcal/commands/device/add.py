"""The command ``device add``. What is slow to import is imported where it is used."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from handcal.commands._options import Anyway, heard
from handcal.commands._registry import say, tell


def add(
    file: Annotated[
        Path, typer.Argument(metavar="PHONE.toml", help="The device file; made if it is not there.")
    ],
    results: Annotated[
        list[Path],
        typer.Argument(metavar="RESULT.json...", help="From `calibrate --json`, `explain --json`."),
    ],
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="The device's name; that of a new file is PHONE."),
    ] = None,
    date: Annotated[
        datetime | None,
        typer.Option(
            formats=["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S"],
            metavar="YYYY-MM-DD",
            help="When it was recorded, where the result does not say so.",
        ),
    ] = None,
    temperature: Annotated[
        float | None,
        typer.Option(metavar="DEGC", help="How warm it was, where the result does not say so."),
    ] = None,
    anyway: Anyway = False,
) -> None:
    """Add what results say of a device to its file, each as a session of its own.

    Kept are biases, errors of gyro and accelerometer, and the lever arm; what else is in a result
    is said. A result that was made with --device counts for what its own recording said. Two
    devices are not mixed, and the same recording counts once.
    """
    from handcal import trust
    from handcal.device import file as device_file
    from handcal.device.history import disagreements
    from handcal.device.left_out import not_kept, sentence
    from handcal.output import check_outputs
    from handcal.show.device import difference_sentence
    from handcal.types import InputError

    check_outputs((file,), results)
    if file.exists():
        device = device_file.read(file)
        if name is not None and name != device.name:
            raise InputError(
                f"{file} is of the device '{device.name}', not of '{name}': two devices are not "
                "mixed."
            )
    else:
        device = device_file.Device(name or file.stem, ())
    if (date is not None or temperature is not None) and len(results) > 1:
        raise InputError("--date and --temperature are of one recording: add results one by one.")
    when = None if date is None else date.replace(tzinfo=UTC)
    for path in results:
        document = device_file.read_result(path)
        session = device_file.session_of(path, document, device.name, when, temperature)
        device = device_file.added(device, session)
        heard(path, trust.of_document(str(path), document), anyway)
        if left := sentence(not_kept(document)):
            say(left if len(results) == 1 else f"{path}: {left}")
    device_file.write(device, file)
    tell(f"{file}: {len(device.sessions)} session{'s' * (len(device.sessions) != 1)}")
    for d in disagreements(device):
        say(difference_sentence(d, device))
