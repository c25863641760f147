"""The command ``lab paper``. What is slow to import is imported where it is used."""

from __future__ import annotations

from typing import Annotated

import typer

from handcal.commands._options import Json, Report
from handcal.commands._progress import progress
from handcal.commands.lab._results import write_results


def paper(
    number: Annotated[str, typer.Argument(metavar="NUMBER", help="000, 001, 003 or 004.")],
    json: Json = None,
    report: Report = None,
) -> None:
    """Compute a paper's figures again and say which of them hold (its page is in docs/)."""
    from handcal.lab.papers.paper import computed
    from handcal.output import check_outputs
    from handcal.show.lab.paper import paper_json, paper_sheet

    check_outputs((json, report))
    with progress(f"computing paper {number}") as bar:
        result = computed(number, bar)
    write_results(lambda _: paper_sheet(result), lambda: paper_json(result), report, json)
