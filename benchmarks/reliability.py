"""Are probabilities frequencies? `python benchmarks/reliability.py TABLE...` counts the claims of
judge tables (`judge-out/judge.json`) by their probability, and shows each table's right outcomes
by suite; `--draw FILE` draws the claims."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import judge_compare
from rich.console import Console

from handcal_sim.prove.score import reliability


def rows_of(tables: Sequence[Path]) -> list[dict[str, Any]]:
    """Claims of all rows that have some, by their probability."""
    rows = [row for path in tables for row in json.loads(path.read_text(encoding="utf-8"))]
    return reliability([(p, true) for row in rows for p, true in row.get("claims", [])])


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Share that came true over the probability that was claimed, with intervals of 95 %."""
    import matplotlib.pyplot as plt

    some = [row for row in rows if row["n"]]
    figure, ax = plt.subplots(figsize=(6.0, 3.4), layout="constrained")
    odds = [row["claimed"] / (1.0 - min(row["claimed"], 1.0 - 1e-5)) for row in some]
    share = [row["share"] for row in some]
    reach = [[s - row["interval"][0] for s, row in zip(share, some, strict=True)],
             [row["interval"][1] - s for s, row in zip(share, some, strict=True)]]  # fmt: skip
    ax.errorbar(odds, share, yerr=reach, fmt="o", color="#0067b3", capsize=3)
    line = [10.0 ** (k / 20.0) for k in range(-20, 101)]
    ax.plot(line, [x / (1.0 + x) for x in line], color="#5b6472", linewidth=1)
    for x, y, row in zip(odds, share, some, strict=True):
        ax.annotate(f"{row['count']} of {row['n']}", (x, y), textcoords="offset points",
                    xytext=(6, -12), fontsize=8)  # fmt: skip
    ax.set(xscale="log", xlabel="odds that were claimed (1: as likely as not)", ylim=(0.0, 1.05),
           ylabel="share that is there", title="What was named, and is there")  # fmt: skip
    figure.savefig(path, dpi=110, metadata={"Software": None})


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="+", type=Path)
    parser.add_argument("--draw", type=Path, metavar="FILE")
    typed = parser.parse_args()
    rows = rows_of(typed.tables)
    for row in rows:
        if row["n"]:
            print(f"{row['claimed']:.4f} claimed: {row['count']} of {row['n']} there "
                  f"({row['interval'][0]:.3f} to {row['interval'][1]:.3f})")  # fmt: skip
    for path in typed.tables:
        table = {row["name"]: row for row in json.loads(path.read_text(encoding="utf-8"))}
        judge_compare.show(judge_compare.compared(table, None), Console(highlight=False))
    if typed.draw:
        draw(rows, typed.draw)


if __name__ == "__main__":
    main()
