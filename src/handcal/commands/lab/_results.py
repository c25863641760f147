"""What a laboratory method found: its page, its JSON and its text, as they were asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from handcal.show.lab.sheet import Sheet


def write_results(
    sheet: Callable[[bool], Sheet],
    document: Callable[[], Mapping[str, Any]],
    report: Path | None,
    json: Path | None,
) -> None:
    """sheet: of the page and the text, with pictures or without; document: the JSON."""
    from handcal.show.calibration.summary import write_json
    from handcal.show.lab.sheet import print_sheet, write_sheet

    if report:
        write_sheet(sheet(True), report)
    if json:
        write_json(document(), json)
    if str(json) != "-":
        from handcal.show.console import Terminal

        print_sheet(sheet(False), Terminal())
