"""The score of a blind trial as tables in the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

from handcal_sim.prove.score import OUTCOMES
from handcal_sim.prove.show_further import FURTHER
from handcal_sim.prove.show_parts import marked, new_table, percent

Row = Mapping[str, Any]


def show(proof: Row, console: Console) -> None:
    """Everything but the list of recordings."""
    console.print(_suites(proof["suites"]))
    if any(row["n"] for row in proof["effects"].values()):
        console.print(_effects(proof["effects"]))
    if proof["unknown"]:
        console.print(_unknown(proof["unknown"]))
    for suite, figures in proof["further"].items():
        for line in FURTHER[suite](figures):
            console.print(line, soft_wrap=True)
    for line in _lines(proof):
        console.print(line, soft_wrap=True)
    if "paired" in proof:
        console.print(_paired(proof["paired"]))


def _paired(rows: list[Row]) -> Table:
    table = new_table(
        "The same recordings by the other program, right", "suite", "both", "this alone",
        "other alone", "neither", "chance",
    )  # fmt: skip
    for row in rows:
        counts = (str(row[k]) for k in ("both", "this_alone", "other_alone", "neither"))
        table.add_row(row["suite"], *counts, f"{row['chance']:.2f}")
    return table


def _suites(rows: list[Row]) -> Table:
    shown = [kind for kind in OUTCOMES if any(row["outcomes"][kind] for row in rows)]
    titles = [kind.replace("_", " ") for kind in shown]
    table = new_table("Blind trial", "suite", "n", *titles, "right", "asked", "")
    for row in rows:
        asked = "-" if row["target"] is None else f"{100.0 * row['target']:g} %"
        verdict = marked(row["met"]).strip() if row["target"] is not None else ""
        counts = [str(row["outcomes"][kind] or "") for kind in shown]
        name = row["suite"] + (f" ({row['group']})" if row["group"] else "")
        table.add_row(name, str(row["n"]), *counts, percent(row["right"]), asked, verdict)
    return table


def _effects(rows: Mapping[str, Row]) -> Table:
    table = new_table("What was there, and what was named", "truth", "n", "named", "in set")
    table.add_column("instead (times)")
    for name, row in rows.items():
        often = sorted(row["instead"].items(), key=lambda item: -item[1])
        instead = ", ".join(f"{other} {n}" for other, n in often)
        count = [str(row[key] or "") for key in ("n", "named", "in_set")]
        table.add_row(name, *count, instead)
    return table


def _unknown(rows: Mapping[str, Mapping[str, int]]) -> Table:
    table = new_table("Outside the catalogue", "kind", "n", "unexplained", "channel", "formula")
    for kind, row in rows.items():
        table.add_row(kind, *(str(row[k]) for k in ("n", "unexplained", "channel", "formula")))
    total = {k: sum(row[k] for row in rows.values()) for k in next(iter(rows.values()))}
    table.add_section()
    table.add_row("all", *(str(n) for n in total.values()))
    return table


def _lines(proof: Row) -> list[str]:
    lines = []
    for title, covered in (
        ("parameters of rightly named effects", proof["coverage"]["effects"]["all"]),
        ("biases", proof["coverage"]["baseline"]),
    ):
        if covered["within_1_sigma"]["n"]:
            one, three = covered["within_1_sigma"], covered["within_3_sigma"]
            lines.append(
                f"Of {one['n']} {title}, {percent(one)} lie within one sigma of the truth "
                f"(68.3 % asked), {percent(three)} within three (99.7 %)."
            )
    claims = [row for row in proof["probabilities"] if row["n"]]
    if claims:
        said = "; ".join(f"{row['claimed']:.3f}: {row['count']} of {row['n']}" for row in claims)
        lines.append(f"Named with probability, and present: {said}.")
    gained = proof["held_out"]
    if gained["gained"]["n"]:
        lines.append(
            f"Held-out data gained in {percent(gained['gained'])} of explanations; "
            f"median {gained['median']:.1f} nats."
        )
    taken = proof["seconds"]
    if taken["median"] is not None:
        lines.append(f"One explanation took {taken['median']:.1f} s (median), "
                     f"{taken['most']:.1f} s at the most.")  # fmt: skip
    failed = [row for row in proof["recordings"] if "error" in row]
    if failed:
        first = failed[0]["error"].strip().splitlines()[-1]
        lines.append(f"[red]{len(failed)} without an explanation[/]; the first: {first}")
    return lines
