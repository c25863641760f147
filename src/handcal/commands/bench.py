"""The command ``bench``. What is slow to import is imported where it is used."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handcal.commands._options import Json

if TYPE_CHECKING:
    from collections.abc import Iterator

    from handcal.bench.timing import Figure, Found, Tick
    from handcal.types import Recording

GROUPS = {
    "filter": "a sample of the filter, over dense C++",
    "filterpy": "filterpy over the filter",
    "pyins": "pyins over the filter",
    "gtsam": "GTSAM's batch smoother over handcal's",
    "epochs": "explain's pass over 84 s, over dense C++",
    "linear": "cost of a sample in recordings of 10 to 10,000 s",
    "reading": "messages read from MCAP",
    "start": "help and calibrate, from the start",
    "memory": "calibrate for one hour and explain for ten minutes: processor time and memory",
    "sweep": "the whole grid of paper 002, on one core and on two",
    "explain": "explain of simulated recordings, and its memory",
    "devices": "explain of every recording in a folder, and its memory",
}
# These take minutes; --all includes them.
LONG = ("memory", "sweep", "explain", "devices")
SCHEMA = "handcal/bench/1"


def bench(
    rounds: Annotated[int, typer.Option(min=1, help="Rounds in which things take turns.")] = 5,
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="GROUP", help=f"Of {', '.join(GROUPS)} (repeatable)."),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help=f"With {', '.join(LONG)} too, which take minutes.")
    ] = False,
    peers: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Scripts of the peers (benchmarks/peers of the sources)."),
    ] = None,
    recordings: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Recordings of real devices, for the group 'devices'."),
    ] = Path("../shared/recordings"),
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="An earlier --json: fail (exit status 1) where a ratio is 30 % worse now.",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Measure handcal on this machine: speed beside other programs, start-up, memory.

    Peers that are not installed are left out; the extra 'bench' brings them.
    """
    from handcal.output import check_outputs
    from handcal.types import InputError

    folders = (peers, recordings) if everything or "devices" in (only or ()) else (peers,)
    check_outputs((json,), (against, *folders))
    earlier = _earlier(against) if against else None
    for name in only or ():
        if name not in GROUPS:
            raise InputError(f"--only {name}: there are {', '.join(GROUPS)}.")
    chosen = [
        g for g in GROUPS if g in (only or ()) or (not only and (everything or g not in LONG))
    ]
    os.environ["OMP_NUM_THREADS"] = "1"
    load = _load()
    found = _measured(chosen, rounds, peers or _beside_the_sources(), recordings)
    if json:
        from handcal.show.calibration.summary import write_json

        write_json(_document(found, rounds, load), json)
    if str(json) != "-":
        _show(found, rounds, load)
    if earlier is not None:
        _check(found, earlier)


def _earlier(path: Path) -> list[dict[str, Any]]:
    """The figures of an earlier run. Raises InputError."""
    from handcal.documents import read_json
    from handcal.types import InputError

    document = read_json(path)
    try:
        figures = document["figures"]
        return [{"title": str(f["title"]), "median": float(f["median"])} for f in figures]
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path} is not what `handcal bench --json` writes.") from None


def _check(found: Found, earlier: list[dict[str, Any]]) -> None:
    """Say which ratios are worse than they were; exit with 1 if one is, or none was compared."""
    from rich.console import Console

    from handcal.bench.check import SLOWER, compared

    console = Console(highlight=False, soft_wrap=True)
    ratios = list(compared(found, earlier))
    for one in ratios:
        word = "as before" if one.passed else f"[red]more than {SLOWER:g} times worse[/]"
        console.print(f"{one.title}: {_number(one.then)} then, {_number(one.now)} now: {word}")
    if not ratios:
        console.print("None of the ratios of that file was measured.")
    if not ratios or not all(one.passed for one in ratios):
        raise typer.Exit(1)


def _beside_the_sources() -> Path:
    return Path(__file__).resolve().parents[3] / "benchmarks" / "peers"


def _load() -> float | None:
    """Share of the processors that were busy before, in the last minute; None: unknown."""
    if not hasattr(os, "getloadavg"):
        return None
    return os.getloadavg()[0] / (os.cpu_count() or 1)


def _measured(groups: list[str], rounds: int, peers: Path, recordings: Path) -> Found:
    from handcal.bench.timing import Missing, Skipped

    found: Found = []
    with TemporaryDirectory(prefix="handcal-bench-") as name, _progress(groups) as told:
        measure = _measurements(Path(name), rounds, peers, recordings)
        for group in groups:
            told(group)
            try:
                found += measure[group](lambda g=group: told(g))  # type: ignore[misc]
            except Missing as problem:
                found.append(Skipped(group, GROUPS[group], str(problem)))
            except KeyboardInterrupt:
                found += [
                    Skipped(g, GROUPS[g], "interrupted.") for g in groups[groups.index(group) :]
                ]
                break
    return found


def _measurements(
    folder: Path, rounds: int, peers: Path, recordings: Path
) -> dict[str, Callable[[Tick], Found]]:
    """How each group is measured."""
    from functools import cache, partial

    from handcal.bench import explaining, filter, program
    from handcal.recordings.inputs import load

    @cache
    def case() -> filter.Case:
        options = ("--device", "paper", "--heading-sigma", "15", "--rate", "100")
        path = program.simulated("z-turn", folder / "z-turn.mcap", *options)
        made = filter.case_of(load(path))
        filter.write_readings(made, folder / "readings.npz")
        return made

    def readings() -> Path:
        case()
        return folder / "readings.npz"

    script = partial(_script, peers)
    pyins = partial(script, "pyins_filter.py")
    gtsam = partial(script, "gtsam_smoother.py")

    def hand() -> Recording:
        return load(program.simulated("free-hand", folder / "hand.mcap", "--duration", "84"))

    f, p = filter, program
    return {
        "filter": lambda tick: f.against_dense(case(), peers, folder, rounds, tick),
        "filterpy": lambda tick: f.against_filterpy(case(), rounds, tick),
        "pyins": lambda tick: f.against_pyins(case(), pyins(readings()), rounds, tick),
        "gtsam": lambda tick: f.against_gtsam(case(), gtsam(readings(), "1"), rounds, tick),
        "epochs": lambda tick: f.epochs_against_dense(hand(), peers, folder, rounds, tick),
        "linear": lambda tick: f.linear_cost(case().problem.recording, rounds, tick),
        "reading": lambda tick: p.reading(folder, script("mcap_messages.py"), rounds, tick),
        "start": lambda tick: p.starting(folder, rounds, tick),
        "memory": lambda tick: p.long_recordings(folder, 1, tick),
        "sweep": lambda tick: p.sweeping(rounds, tick),
        "explain": lambda tick: explaining.explaining(folder, rounds, tick),
        "devices": lambda tick: explaining.devices(recordings, tick),
    }


def _script(peers: Path, name: str, *arguments: str | Path) -> list[str | Path]:
    """The command that runs a peer. Raises Missing."""
    from handcal.bench.filter import no_peers
    from handcal.bench.timing import Missing

    if not (peers / name).is_file():
        raise Missing(no_peers(peers))
    return [sys.executable, peers / name, *arguments]


@contextmanager
def _progress(groups: list[str]) -> Iterator[Callable[[str], None]]:
    """On stderr: which group is being measured, and how many are done."""
    from rich.console import Console

    console = Console(stderr=True)
    with console.status("") as status:

        def told(group: str) -> None:
            status.update(f"{group} ({groups.index(group) + 1} of {len(groups)}): {GROUPS[group]}")

        yield told


# ---- what is shown ----------------------------------------------------------------------------


def _show(found: Found, rounds: int, load: float | None) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from handcal.bench.timing import Figure

    console = Console(highlight=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading, justify in (("", "left"), ("median", "right"), ("", "left"),
                             ("rounds", "left"), ("asked", "left"), ("", "left")):  # fmt: skip
        table.add_column(heading, justify=justify)  # type: ignore[arg-type]
    for one in found:
        if isinstance(one, Figure):
            table.add_row(*_row(one))
    if table.rows:
        console.print(table)
        text = "cpu: time of one thread on the processor; wall: by the clock."
        console.print(f"Medians of {rounds} rounds, with the least and the most. {text}")
    for one in found:
        if not isinstance(one, Figure):
            console.print(f"Left out: {one.title}: {one.reason}", soft_wrap=True)
    if load is not None and load > 0.5:
        console.print(
            f"This machine was busy before (load {load:.1f} a core): times by the clock are longer "
            "than they need be, and others somewhat.", soft_wrap=True,
        )  # fmt: skip


def _row(figure: Figure) -> tuple[str, ...]:
    low, high = figure.rounds.min(), figure.rounds.max()
    unit = "" if figure.unit == "x" else figure.unit
    spread = f"{_number(low)} to {_number(high)}" if len(figure.rounds) > 1 else ""
    asked, verdict = "", ""
    if figure.target is not None:
        word = "at most" if figure.target.at_most else "at least"
        asked = f"{word} {_number(figure.target.value)}"
        verdict = "[green]met[/]" if figure.met else "[red]missed[/]"
    title = figure.title if figure.target is not None else f"[dim]{figure.title}[/]"
    return title, _number(figure.value), f"{unit} {figure.clock}".strip(), spread, asked, verdict


def _number(value: float) -> str:
    """Three digits, none of them after a hundred."""
    if value >= 99.95:
        return f"{value:,.0f}"
    return f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def _document(found: Found, rounds: int, load: float | None) -> dict[str, Any]:
    from handcal.bench.timing import Figure

    figures = [
        {
            "group": f.group, "title": f.title, "unit": f.unit, "clock": f.clock or None,
            "median": f.value, "rounds": f.rounds.tolist(),
            "target": f.target and {"at_most" if f.target.at_most else "at_least": f.target.value},
            "met": f.met,
        }
        for f in found if isinstance(f, Figure)
    ]  # fmt: skip
    skipped = [
        {"group": s.group, "title": s.title, "reason": s.reason}
        for s in found if not isinstance(s, Figure)
    ]  # fmt: skip
    return {
        "schema": SCHEMA, "machine": _machine(load), "rounds": rounds,
        "figures": figures, "skipped": skipped,
    }  # fmt: skip


def _machine(load: float | None) -> dict[str, Any]:
    from importlib.metadata import version

    names = ("handcal", "numpy", "numba")
    return {
        "processor": platform.processor() or platform.machine(), "cores": os.cpu_count(),
        "system": platform.system(), "python": platform.python_version(),
        "load_before": load, "versions": {name: version(name) for name in names},
    }  # fmt: skip
