"""Two tables of `make judge`, or one, in figures by suite; and which recordings changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from handcal_sim.prove.score_strange import SURE
from handcal_sim.prove.show_parts import new_table
from handcal_sim.prove.trial import share

Row = Mapping[str, Any]
Rows = Mapping[str, Row]
TOTAL = "all"


def compared(after: Rows, before: Rows | None) -> dict[str, Any]:
    """Figures by suite, before and after, of the recordings that both have; of one table alone
    where there is no other. Those of one name that are not the same recording are left out."""
    names, differ = list(after), []
    if before is not None:
        both = [name for name in after if name in before]
        differ = [n for n in both if before[n].get("sha256") != after[n].get("sha256")]
        names = [name for name in both if name not in differ]
    tables = [after] if before is None else [before, after]
    pairs = [[table[name] for table in tables] for name in names]
    suites = list(dict.fromkeys(after[name]["suite"] for name in names))
    alone = set(after) ^ set(before or after)
    return {
        "suites": [
            _figures(suite, [p for p in pairs if suite in (TOTAL, p[-1]["suite"])])
            for suite in (*suites, TOTAL)
        ],
        "changed": [] if before is None else [c for p in pairs if (c := _changed(*p))],
        "differ": differ,
        "alone": sorted(alone),
    }


def gained(before: Row, after: Row) -> float | None:
    """Nats by which the final fit became more probable, where both say."""
    one, other = before.get("log_evidence"), after.get("log_evidence")
    return None if one is None or other is None else round(other - one, 2)


def _figures(suite: str, pairs: Sequence[Sequence[Row]]) -> dict[str, Any]:
    sides = [_side(rows) for rows in zip(*pairs, strict=True)]
    nats = [x for p in pairs if (x := gained(p[0], p[-1])) is not None]
    ended = [p for p in pairs if all(row["verdict"] != "failed" for row in p)]
    ratios = [p[-1]["processor_s"] / p[0]["processor_s"] for p in ended if p[0]["processor_s"]]
    return {"suite": suite, "n": len(pairs), "sides": sides, "nats": round(sum(nats), 2),
            "time_ratio": median(ratios) if ratios else None}  # fmt: skip


def _side(rows: Sequence[Row]) -> dict[str, Any]:
    """Shares of right outcomes and of parameters near the truth, and median times. What should
    have been named, and was not, is near nothing."""
    judged = [row["right"] for row in rows if row["right"] is not None]
    off = [x for row in rows for x in row["off"].values()]
    near = {f"within_{k}": share(sum(x is not None and abs(x) < k for x in off), len(off))
            for k in (1, 2)}  # fmt: skip
    times = {key: median(row[key] for row in rows) for key in ("seconds", "processor_s")}
    return {"right": share(sum(judged), len(judged)), **near, **times}


def _changed(before: Row, after: Row) -> dict[str, Any] | None:
    """What is said otherwise of a recording, or as much more or less probable as counts."""
    keys = ("outcome", "verdict", "named", "unnamed")
    nats = gained(before, after)
    if abs(nats or 0.0) <= SURE and all(before.get(k) == after.get(k) for k in keys):
        return None
    sides = [{k: row.get(k) for k in keys} for row in (before, after)]
    return {"name": after["name"], "before": sides[0], "after": sides[1], "nats": nats}


def show(figures: Mapping[str, Any], console: Console) -> None:
    """As tables in the terminal, before above after."""
    columns = ("suite", "n", "right, %", "1 sigma, %", "2 sigma, %", "s")
    if len(figures["suites"][-1]["sides"]) == 2:
        columns += ("nats", "time")
    table = new_table("Judged: right outcomes, parameters near the truth, processor time", *columns)
    table.padding = (0, 1, 0, 0)
    for row in figures["suites"]:
        cells = ["\n".join(_percent(side[key]) for side in row["sides"])
                 for key in ("right", "within_1", "within_2")]  # fmt: skip
        cells.append("\n".join(f"{side['processor_s']:.0f}" for side in row["sides"]))
        ratio = "-" if row["time_ratio"] is None else f"{row['time_ratio']:.2f}"
        more = (f"{row['nats']:+.1f}", ratio) if len(columns) > len(cells) + 2 else ()
        if row["suite"] == TOTAL:
            table.add_section()
        table.add_row(row["suite"], str(row["n"]), *cells, *more)
    console.print(table)
    if figures["changed"]:
        console.print(_changes(figures["changed"]))
    for key, text in (("differ", "not the same recording, left out"), ("alone", "in one table")):
        if figures[key]:
            console.print(f"{len(figures[key])} {text}: {', '.join(figures[key])}", soft_wrap=True)


def _percent(share: Row) -> str:
    """A share and its interval, short: 98 (94-100)."""
    low, high = (100.0 * x for x in share["interval"])
    return f"{100.0 * share['share']:.0f} ({low:.0f}-{high:.0f})" if share["n"] else "-"


def _changes(rows: Sequence[Mapping[str, Any]]) -> Table:
    table = new_table("Changed", "recording", "nats", "before", "after")
    for column in table.columns[2:]:
        column.justify, column.overflow = "left", "fold"
    for row in rows:
        nats = "-" if row["nats"] is None else f"{row['nats']:+.1f}"
        table.add_row(row["name"], nats, *(escape(_told(row[k])) for k in ("before", "after")))
    return table


def _told(side: Mapping[str, Any]) -> str:
    """Outcome and verdict; names with those of their sets; laws as channels and drivers."""
    names = [" | ".join(s) for s in side["named"] or ()]
    laws = [f"{'+'.join(u['channels'])}({', '.join(u['drivers'])})" for u in side["unnamed"] or ()]
    head = ", ".join(s for s in (side["outcome"], side["verdict"]) if s)
    return "; ".join([head, *names, *laws])
