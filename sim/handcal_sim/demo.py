"""The command `demo`: the whole way with no input. It sees both sides: truth and estimate."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
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
        int, typer.Option(min=0, help="Another device, another hand, another error.")
    ] = 1,
) -> None:
    """Simulate a recording that conceals an error, calibrate it, and compare with the truth.

    Writes recording.mcap, report.html, dashboard.rrd and calibration.json.
    """
    import handcal
    from handcal.commands import say
    from handcal.dashboard import save_rrd
    from handcal.progress import progress
    from handcal.report import write_report
    from handcal.summary import calibration_json, write_json
    from handcal_sim.mcap_writer import write

    out.mkdir(parents=True, exist_ok=True)
    file = out / "recording.mcap"
    say("simulating 30 s of a phone turned in the hand")
    world = concealing(seed)
    write(world, file)
    recording = handcal.load(file)
    say("calibrating: biases and gyro scale")
    with progress("biases and gyro scale") as report:
        result = handcal.calibrate(recording, (CONCEALED,), assume="fixed-point", progress=report)
    # A gyro scale that is left out can pass for noise of the gyro, so that is held.
    held = {n.name: n.value for n in result.noise if n.name == "gyro_noise"}
    say("calibrating: biases alone, to compare")
    with progress("biases alone") as report:
        without = handcal.calibrate(recording, noise=held, assume="fixed-point", progress=report)
    say("writing the results")
    write_report(result, out / "report.html")
    save_rrd(result, out / "dashboard.rrd")
    write_json(calibration_json(result), out / "calibration.json")
    _show(truth_of(world), without, result, out)


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
    """How far the estimate is from the truth, in sigmas."""
    return (p.value - truth[p.effect, p.name]) / p.sigma


def _show(truth: Mapping[Key, float], without: Result, result: Result, out: Path) -> None:
    """Truth beside estimate in the terminal, and what to look at next."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from handcal import words

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    for column in ("truth", "estimate", "± 1 sigma", ""):
        table.add_column(column, justify="left" if not column else "right")
    table.add_column("off by", justify="right")
    for group in words.by_effect(result.parameters).values():
        unit = words.shown_group(group)
        for p in group:
            true = unit.value(truth[p.effect, p.name], p.sigma, sign=True)
            row = (unit.value(p.value, p.sigma, sign=True), unit.value(p.sigma, p.sigma))
            size = f"{abs(off_by(p, truth)):.1f} sigma"
            table.add_row(words.parameter_title(p), true, *row, unit.unit, size)
    off = [abs(off_by(p, truth)) for p in result.parameters]
    inside, n = sum(o < 2.0 for o in off), len(off)
    wrong = max(abs(off_by(p, truth)) for p in without.parameters)
    gain = result.log_evidence - without.log_evidence
    console = Console(highlight=False)
    console.print(
        "A simulated phone was held and turned once about each axis. Its gyro secretly misreads "
        "every turn by up to 1.2 %. What handcal made of the recording:", soft_wrap=True,
    )  # fmt: skip
    console.print(table)
    console.print(
        f"{inside} of {n} estimates lie within two sigma of the truth; the worst is off by "
        f"{max(off):.1f}.", soft_wrap=True,
    )  # fmt: skip
    console.print(
        f"Leave the scale error out at the same gyro noise, and log evidence falls by "
        f"[bold]{gain:.0f}[/] and biases are off by up to {wrong:.0f} sigma.\n", soft_wrap=True,
    )  # fmt: skip
    console.print("Look next at", style="bold")
    for name, what in (
        ("report.html", "the report, in a browser"),
        ("dashboard.rrd", "the same over time: rerun " + str(out / "dashboard.rrd")),
        ("calibration.json", "the numbers"),
        ("recording.mcap", f"watch the filter at work: handcal replay {out / 'recording.mcap'}"
                           f" --effects {CONCEALED}"),
    ):  # fmt: skip
        console.print(f"  {out / name}  [dim]{what}[/]", soft_wrap=True)
