"""Tables as a notebook and a Python prompt show them."""

from __future__ import annotations

import html
from collections.abc import Collection, Iterable, Sequence
from typing import Any

from handcal.types import HandcalError


def frame(columns: Sequence[str], rows: Sequence[Sequence[Any]], instead: str) -> Any:
    """A pandas.DataFrame. Errors: HandcalError where pandas is not installed; instead: what else
    there is."""
    try:
        import pandas
    except ImportError:
        raise HandcalError(
            "pandas is not installed: `pip install pandas` (or handcal with its extra `notebook`), "
            f"or {instead}."
        ) from None
    return pandas.DataFrame(rows, columns=list(columns))


def text(columns: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[int]) -> str:
    """Lines of equal width; right: columns that are flush right."""
    table = [columns, *rows]
    width = [max(len(row[k]) for row in table) for k in range(len(columns))]
    lines = (
        "  ".join(
            f"{cell:>{n}}" if k in right else f"{cell:<{n}}"
            for k, (cell, n) in enumerate(zip(row, width, strict=True))
        )
        for row in table
    )
    return "\n".join(line.rstrip() for line in lines)


def html_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of HTML."""
    head = "".join(f"<th>{html.escape(c)}</th>" for c in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def paragraphs(sentences: Iterable[str]) -> str:
    """Sentences as HTML."""
    return "".join(f"<p>{html.escape(s)}</p>" for s in sentences)
