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
        Path,
        typer.Argument(metavar="PHONE.toml", help="The device file; created if it does not exist."),
    ],
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT.json...", help="Results of `calibrate --json` or `explain --json`."
        ),
    ],
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="The device's name; by default the file's name (PHONE)."),
    ] = None,
    date: Annotated[
        datetime | None,
        typer.Option(
            formats=["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S"],
            metavar="YYYY-MM-DD",
            help="Date of the recording, if the result does not hold it.",
        ),
    ] = None,
    temperature: Annotated[
        float | None,
        typer.Option(
            metavar="DEGC", help="Temperature of the recording, if the result does not hold it."
        ),
    ] = None,
    anyway: Anyway = False,
) -> None:
    """Add results to the file of a device, each as a session of its own.

    The file keeps biases, errors of gyro and accelerometer, and the lever arm; what it does not
    keep of a result is printed. A result that was made with --device adds only the information of
    its own recording. Results of another device are refused. The same recording counts once.
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
        raise InputError(
            "--date and --temperature belong to one recording: add results one by one."
        )
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
