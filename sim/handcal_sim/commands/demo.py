"""The command `demo`: the whole way with no input. It sees both sides: truth and estimate."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from handcal.explain import Explanation
    from handcal.types import Parameter, Result
    from handcal_sim.scenario import World

CONCEALED = "gyro_scale"
LEAST, MOST = 0.004, 0.012
Key = tuple[str, str]


def demo(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="The folder to write to.")
    ] = Path("demo-out"),
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the simulated device, hand and error.")
    ] = 1,
) -> None:
    """Simulate a recording that conceals an error, calibrate, explain, compare with the truth.

    Writes recording.mcap; explanation.html, .rrd and .json; report.html, dashboard.rrd and
    calibration.json.
    """
    import handcal
    from handcal.commands._precompile import compiled_ahead
    from handcal.commands._progress import progress
    from handcal.commands._registry import say
    from handcal.explain import explain
    from handcal.show.calibration.report import write_report
    from handcal.show.calibration.summary import calibration_json, write_json
    from handcal.show.dashboard import save_explanation_rrd, save_rrd
    from handcal.show.explanation.document import explanation_json
    from handcal.show.explanation.next_commands import commands
    from handcal.show.explanation.report import write_explanation_report
    from handcal_sim.mcap_writer import write

    out.mkdir(parents=True, exist_ok=True)
    file = out / "recording.mcap"
    say("simulating 30 s of a phone turned in the hand")
    world = concealing(seed)
    write(world, file)
    recording = handcal.load(file)
    say("calibrating: biases alone")
    with progress("biases alone") as report, compiled_ahead():
        plain = handcal.calibrate(recording, assume="fixed-point", only=True, progress=report)
    say("explaining: what do biases not account for?")
    with progress("explaining") as report:
        explanation = explain([recording], assume="fixed-point", progress=report)
    named = tuple(m.effect for m in explanation.missing)
    say(f"calibrating: biases and {', '.join(named) or 'nothing else'}")
    with progress("with what was found") as report:
        result = handcal.calibrate(recording, named, assume="fixed-point", progress=report)
    say("writing the results")
    following = commands(explanation, [str(file)], json=str(out / "explanation.json"))
    write_explanation_report(explanation, out / "explanation.html", following)
    save_explanation_rrd(explanation, out / "explanation.rrd")
    write_json(explanation_json(explanation), out / "explanation.json")
    write_report(result, out / "report.html")
    save_rrd(result, out / "dashboard.rrd")
    write_json(calibration_json(result), out / "calibration.json")
    _show(truth_of(world), plain, explanation, result, out)


def concealing(seed: int) -> World:
    """Three turns of a consumer's phone whose gyro misreads every turn, by how much is drawn."""
    import numpy as np

    from handcal_sim.scenario import simulate

    drawn = np.random.default_rng([seed, 1])
    scale = drawn.choice([-1.0, 1.0], 3) * drawn.uniform(LEAST, MOST, 3)
    return simulate("three-turns", seed=seed, effects={CONCEALED: scale.tolist()})


def truth_of(world: World) -> Mapping[Key, float]:
    """What was injected, SI, by effect and name."""
    return {
        (effect, p["name"]): p["value"]
        for effect, parameters in world.parameters["effects"].items()
        for p in parameters
    }


def off_by(p: Parameter, truth: Mapping[Key, float]) -> float:
    """How far the estimate is from the truth, in sigmas. What was not injected is zero."""
    return (p.value - truth.get((p.effect, p.name), 0.0)) / p.sigma


def _show(
    truth: Mapping[Key, float], plain: Result, explanation: Explanation, result: Result, out: Path
) -> None:
    """Truth beside estimate in the terminal, and what to look at next."""
    from rich.console import Console

    from handcal.show.calibration import verdict_text as calibrated
    from handcal.show.explanation import verdict_text as explained

    console = Console(highlight=False)

    console.print(
        "A simulated phone was held and turned once about each axis. Its gyro secretly misreads "
        "every turn by up to 1.2 %. Handcal is given the recording alone."
    )
    console.print(f"\n[bold]Biases alone:[/] {calibrated.verdict(plain).headline}")
    console.print(f"[bold]Explained:[/] {explained.verdict(explanation).headline}")
    console.print(_table(truth, result))
    off = [abs(off_by(p, truth)) for p in result.parameters]
    console.print(
        f"{sum(o < 2.0 for o in off)} of {len(off)} estimates lie within two sigma of the truth; "
        f"the worst is off by {max(off):.1f}.\n"
    )
    console.print("Look next at", style="bold")
    effects = ",".join(m.effect for m in explanation.missing)
    watch = f"handcal replay {out / 'recording.mcap'}" + (
        f" --effects {effects}" if effects else ""
    )
    for name, what in (
        ("explanation.html", "what was found and how that shows, in a browser"),
        ("report.html", "the calibration with it, in a browser"),
        ("explanation.rrd, dashboard.rrd", f"the same over time: rerun {out / 'dashboard.rrd'}"),
        ("explanation.json, calibration.json", "the numbers"),
        ("recording.mcap", f"watch the filter at work: {watch}"),
    ):
        files = ", ".join(str(out / one) for one in name.split(", "))
        console.print(f"  {files}  [dim]{what}[/]", soft_wrap=True)


def _table(truth: Mapping[Key, float], result: Result) -> Table:
    from handcal.show import words
    from handcal.show.terminal import table

    rows = table("*", ">*truth", ">*estimate", ">*± 1 sigma", "*", ">*off by")
    for group in words.by_effect(result.parameters).values():
        unit = words.shown_group(group)
        for p in group:
            true = unit.value(truth.get((p.effect, p.name), 0.0), p.sigma, sign=True)
            row = (unit.value(p.value, p.sigma, sign=True), unit.value(p.sigma, p.sigma))
            size = f"{abs(off_by(p, truth)):.1f} sigma"
            rows.add_row(words.parameter_title(p), true, *row, unit.unit, size)
    return rows
