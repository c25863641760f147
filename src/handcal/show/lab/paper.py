"""A paper computed again, for a person and as JSON."""

from __future__ import annotations

from typing import Any

from handcal.lab.papers.paper import CORRECTED, FAILS, HOLDS, UNKNOWN, Paper
from handcal.show.lab.sheet import Sheet


def paper_sheet(paper: Paper) -> Sheet:
    """What a person sees."""
    held = [c.verdict for c in paper.claims]
    counted = [(f"{held.count(v)}", v) for v in (HOLDS, CORRECTED, FAILS, UNKNOWN) if v in held]
    return Sheet(
        f"Paper {paper.number}", f"{paper.source}.", tuple(counted), (), (), paper.tables()
    )


def paper_json(paper: Paper) -> dict[str, Any]:
    """``lab paper --json``."""
    return {
        "schema": "handcal/lab-paper/1",
        "number": paper.number,
        "source": paper.source,
        "claims": [{"claim": c.claim, "printed": c.printed, "computed": c.computed,
                    "verdict": c.verdict} for c in paper.claims],
        "beyond": [{"what": w, "paper": p, "handcal": h} for w, p, h in paper.beyond],
        "tables": [{"heading": t.heading, "columns": list(t.columns),
                    "rows": [list(r) for r in t.rows]} for t in paper.more],
    }  # fmt: skip
