"""The command ``device show``. What is slow to import is imported where it is used."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from handcal.commands._options import Json, Report, UnitsToo, in_units


@in_units
def show(
    file: Annotated[Path, typer.Argument(metavar="PHONE.toml", help="A device file.")],
    date: Annotated[
        datetime | None,
        typer.Option(
            formats=["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S"],
            metavar="YYYY-MM-DD",
            help="Show the state on that day; today if not given.",
        ),
    ] = None,
    units: UnitsToo = None,
    json: Json = None,
    report: Report = None,
) -> None:
    """Print what is known of a device, from which sessions, and where sessions disagree."""
    if units:
        from handcal.types import InputError

        raise InputError(f"--units {units}: a device file is SI; say only what to show (deg,mg).")
    from handcal.device import file as device_file
    from handcal.output import check_outputs
    from handcal.show import device as page
    from handcal.show.calibration.summary import write_json

    check_outputs((json, report), (file,))
    device = device_file.read(file)
    when = datetime.now(UTC) if date is None else date.replace(tzinfo=UTC)
    if report:
        page.write_device_report(device, when, report)
    if json:
        write_json(page.device_json(device, when), json)
    if str(json) != "-":
        from handcal.show.console import Terminal

        page.print_device(device, when, Terminal())
