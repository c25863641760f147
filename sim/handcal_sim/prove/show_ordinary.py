"""What `ordinary` finds, as tables for the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from rich.console import RenderableType
from rich.table import Table

from handcal_sim.prove.show_parts import Row, marked, new_table, percent


def tables(found: Row) -> Iterator[RenderableType]:
    """Of `ordinary.result`."""
    yield covered("All parameters", found["coverage"])
    for name, rows in found["by"].items():
        title = f"By {name}" if name != "besides" else "By what the device has besides"
        yield covered(title, rows)
    yield _worst(found["worst"])
    yield from applied(found["apply"])
    yield from bounds(found["asked"])
    taken = found["seconds"]["median"]
    yield f"seed {found['seed']}; median {taken or 0.0:.1f} s; {len(found['failed'])} failed"
    for name, error in found["failed"].items():
        yield f"[red]{name}[/]: {error.strip().splitlines()[-1]}"


def covered(title: str, rows: Mapping[str, Row]) -> Table:
    """Shares within sigmas, a part a row."""
    columns = ("", "n", "shown", "sigma/spread", "within 1 sigma", "within 2 sigma", "rms")
    table = new_table(title, *columns)
    for name, row in rows.items():
        known, rms = ("-" if row[k] is None else f"{row[k]:.2f}"
                      for k in ("sigma_over_spread", "rms"))  # fmt: skip
        shares = (percent(row[f"within_{k}_sigma"]) for k in (1, 2))
        counts = (str(n) for n in (row["within_1_sigma"]["n"], row["shown"]))
        table.add_row(name.replace("_", " "), *counts, known, *shares, rms)
    return table


def _worst(rows: Sequence[Row]) -> Table:
    columns = ("class", "motion", "stream", "parameter", "truth", "told", "sigma", "off", "shown")
    table = new_table("Farthest off", "number", *columns)
    for row in rows:
        numbers = (f"{row[k]:+.3g}" for k in ("truth", "value"))
        table.add_row(
            row["recording"], row["class"], row["motion"], row["stream"],
            f"{row['effect']}.{row['name']}", *numbers, f"{row['sigma']:.2g}",
            f"{row['sigmas']:+.1f}", "yes" if row["shown"] else "",
        )  # fmt: skip
    return table


def applied(rows: Sequence[Row]) -> Iterator[RenderableType]:
    """What corrections leave, if that was asked."""
    if not rows:
        return
    columns = ("sensor", "what", "rms before", "after", "median left", "made worse",
               "expected worse", "left over expected (mean, median)")  # fmt: skip
    table = new_table("Another recording of the device, corrected", *columns)
    for row in rows:
        table.add_row(row["sensor"], row["what"], f"{row['before']:.3g}", f"{row['after']:.3g}",
                      f"{100.0 * row['median_left']:.0f} %", percent(row["worse"]),
                      *_foreseen(row))  # fmt: skip
    yield table


def _foreseen(row: Row) -> tuple[str, str]:
    if "worse_expected" not in row:
        return "", ""
    over = f"{row['left_over_expected']:.2f}, {row['median_over_expected']:.2f}"
    return f"{100.0 * row['worse_expected']:.0f} %", over


def bounds(rows: Sequence[Row]) -> Iterator[str]:
    """What is asked of the numbers, beside what was measured."""
    for row in rows:
        off = "at least" if row["off"] is None else f"+-{100.0 * row['off']:g} %:"
        yield (
            f"ordinary: {row['part'].replace('_', ' ')} within {row['sigmas']} sigma: "
            f"{percent(row['measured'])} of {row['measured']['n']}; asked {off} "
            f"{100.0 * row['asked']:g} %{marked(row['met'])}"
        )


def explained(figures: Row) -> list[RenderableType]:
    """The suite's part of a proof."""
    asked = figures["names_asked"]
    said = {
        name: f"{percent(figures[name])} of {figures[name]['n']} ({100.0 * row['asked']:g} % "
        f"{'at most ' if name == 'false_rare' else ''}asked){marked(row['met'])}"
        for name, row in asked.items()
    }

    def often(counts: Mapping[str, int]) -> str:
        named = ", ".join(f"{k} {n}" for k, n in sorted(counts.items(), key=lambda i: -i[1]))
        return f": {named}." if named else "."

    return [
        covered("ordinary: all parameters", figures["coverage"]),
        *bounds(figures["numbers_asked"]),
        f"ordinary: of common effects beyond five sigmas, named {said['found']}; not"
        + often(figures["not_found"]),
        f"ordinary: of rare effects and laws beyond ten sigmas, told {said['rare_found']}.",
        f"ordinary: devices with a false rare name {said['false_rare']}"
        + often(figures["false_names"]),
    ]
