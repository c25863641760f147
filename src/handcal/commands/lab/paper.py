"""The command ``lab paper``. What is slow to import is imported where it is used."""

from __future__ import annotations

from typing import Annotated

import typer

from handcal.commands._options import Json, Report
from handcal.commands._progress import progress


def paper(
    number: Annotated[str, typer.Argument(metavar="NUMBER", help="000, 001, 003 or 004.")],
    json: Json = None,
    report: Report = None,
) -> None:
    """Compute a paper's figures again and say which of them hold (its page is in docs/)."""
    from handcal.lab.papers.paper import computed
    from handcal.output import check_outputs
    from handcal.show.calibration.summary import write_json
    from handcal.show.lab.paper import paper_json, paper_sheet
    from handcal.show.lab.sheet import print_sheet, write_sheet

    check_outputs((json, report))
    with progress(f"computing paper {number}") as bar:
        result = computed(number, bar)
    if report:
        write_sheet(paper_sheet(result), report)
    if json:
        write_json(paper_json(result), json)
    if str(json) != "-":
        from handcal.show.terminal import Terminal

        print_sheet(paper_sheet(result), Terminal())
