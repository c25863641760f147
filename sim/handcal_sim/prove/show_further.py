"""What single suites ask for beyond names, as lines for the terminal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rich import box
from rich.console import RenderableType
from rich.table import Table

from handcal_sim.prove import show_ordinary
from handcal_sim.prove.show_parts import marked, percent

Row = Mapping[str, Any]


def _coverage(rows: Mapping[str, Row], asked: Row | None = None) -> str:
    """All reported parameters, and those effects of which more than one in a hundred is off."""
    three = {name: row["within_3_sigma"] for name, row in rows.items()}
    every = three.pop("all")
    off = ", ".join(
        f"{name} {row['n'] - row['count']} of {row['n']}"
        for name, row in three.items()
        if (row["share"] or 0.0) < 0.99
    )
    target = f"; {100.0 * asked['target']:g} % asked{marked(asked['met'])}" if asked else ""
    return (
        f"Of {every['n']} reported parameters {percent(every)} lie within three sigma of the truth"
        f"{target}." + (f" Beyond: {off}." if off else "")
    )


def _phone(figures: Row) -> list[RenderableType]:
    claims = figures["impossible"]
    return [
        "phone: " + _coverage(figures["parameters"], figures["asked"]),
        f"phone: {claims['count']} of {claims['n']} recordings claim a value beyond 5 % or 5 deg; "
        f"none asked{marked(claims['count'] == 0)}.",
    ]


def _odometry(figures: Row) -> list[RenderableType]:
    wrong, right = figures["perfect_said_to_drift"], figures["drift_found"]
    judged = marked(wrong["count"] == 0 if wrong["n"] else None)
    return [
        f"odometry: {wrong['count']} of {wrong['n']} perfect trackers are said to drift; "
        f"none asked{judged}. Of those that drift, {percent(right)} are.",
        "odometry: " + _coverage(figures["parameters"]),
    ]


def _people(figures: Row) -> list[RenderableType]:
    wrong = {k: row for k, row in figures["doings"].items() if row["false"]}
    said = "; ".join(
        f"{doing} {row['false']} of {row['n']} ({', '.join(row['named'])})"
        for doing, row in wrong.items()
    )
    verdicts = ", ".join(f"{verdict} {n}" for verdict, n in figures["verdicts"].items())
    return [f"people: taken for errors of sensors: {said or 'nothing'}. Verdicts: {verdicts}."]


def _budget(figures: Row) -> list[RenderableType]:
    left, names = figures["left"], figures["names"]
    shares = "-"
    if left["n"]:
        shares = f"median {100.0 * left['median']:.1f} %, worst {100.0 * left['worst']:.1f} %"
        least = left["told"]
        shares += (
            f" (told all names: {100.0 * least['median']:.1f} and {100.0 * least['worst']:.1f} %)"
        )
    asked = left["asked"]
    return [
        f"budget: of the gyro's error in another recording there is left: {shares} of {left['n']}; "
        f"{100.0 * asked['median']:g} and {100.0 * asked['worst']:g} % asked, or "
        f"{asked['beside_told']:g} times what is left if told"
        f"{marked(left['met'])}.",
        f"budget: {percent(names)} of {names['n']} effects are named.",
        "budget: " + _coverage(figures["parameters"]),
    ]


def _strange(figures: Row) -> list[RenderableType]:
    table = Table(title="Laws outside the catalogue", title_justify="left", box=box.SIMPLE_HEAD,
                  pad_edge=False)  # fmt: skip
    for column in ("recording", "law", "on", "verdict", "channel", "driver", "false", "left",
                   "if told", "but numbers", "truth"):  # fmt: skip
        table.add_column(column)
    for row in figures["laws"]:
        told = ["yes" if row[key] else "" for key in ("channel", "driver")]
        shares = ("-" if row[key] is None else f"{100.0 * row[key]:.2g} %"
                  for key in ("left", "told", "form"))  # fmt: skip
        truth = "-" if row["truth"] is None else f"{row['truth']:+.0f}"
        table.add_row(row["recording"], row["law"], " ".join(row["channels"]), row["verdict"],
                      *told, " ".join(row["false"]), *shares, truth)  # fmt: skip
    said = {key: percent(figures[key]) for key in
            ("told", "driver", "clean", "false", "nothing_left", "little_left",
             "nothing_left_if_told", "nothing_left_if_form", "truth_is_likelier")}  # fmt: skip
    return [
        table,
        f"strange: {said['told']} of recordings are told rightly: unexplained, on the right "
        f"channels; with the right drivers too: {said['driver']} (90 % asked).",
        f"strange: called clean: {said['clean']} (2 % at most asked); with a catalogue name that "
        f"is not there: {said['false']} (5 % at most asked).",
        f"strange: of {figures['little_left']['n']} laws, names and curves leave at most a tenth "
        f"of {said['little_left']}, at most a hundredth of {said['nothing_left']} (60 % asked).",
        f"strange: told the law and all names, calibrate leaves at most a hundredth of "
        f"{said['nothing_left_if_told']} of {figures['nothing_left_if_told']['n']}; told them but "
        f"for the law's numbers, of {said['nothing_left_if_form']}.",
        f"strange: of {figures['truth_is_likelier']['n']} recordings of which a driver is not told "
        f"and the truth was asked, it is likelier than the explanation in "
        f"{said['truth_is_likelier']}.",
    ]


FURTHER: Mapping[str, Callable[[Row], list[RenderableType]]] = {
    "phone": _phone,
    "odometry": _odometry,
    "people": _people,
    "budget": _budget,
    "strange": _strange,
    "latest": _strange,
    "ordinary": show_ordinary.explained,
}
