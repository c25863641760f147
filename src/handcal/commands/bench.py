"""The command ``bench``. What is slow to import is imported where it is used."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from handcal.commands._ending import INTERRUPTED
from handcal.commands._options import Json
from handcal.commands._progress import progress
from handcal.commands._registry import say

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from handcal.bench.timing import Found, Row, Rows, Skipped, Tick
    from handcal.types import Recording


class Group(NamedTuple):
    """What a group of figures measures, and about how long that takes.

    The times are those of five rounds on two cores, with nothing to compile. They are told in the
    help, and nothing else depends on them.
    """

    text: str
    takes: str


GROUPS = {
    "filter": Group("a sample of the filter, over dense C++", "15 s"),
    "filterpy": Group("filterpy over the filter", "10 s"),
    "pyins": Group("pyins over the filter", "1 min"),
    "gtsam": Group("GTSAM's batch smoother over handcal's", "15 s"),
    "epochs": Group("explain's pass over 84 s, over dense C++", "10 s"),
    "linear": Group("cost of a sample in recordings of 10 to 10,000 s", "35 s"),
    "reading": Group("messages read from MCAP", "15 s"),
    "start": Group("help and calibrate, from the start", "4 min"),
    "memory": Group("calibrate for one hour and explain for ten minutes: time, memory", "2 min"),
    "sweep": Group("the whole grid of paper 002, on one core and on two", "3 min"),
    "explain": Group("explain of simulated recordings, and its memory", "10 min"),
    "devices": Group("explain of every recording in a folder, and its memory", "2 min a recording"),
}
# These are not worth their time every day; --all includes them.
LONG = ("memory", "sweep", "explain", "devices")
# Parts of a profile on the terminal; the file has them all.
SHOWN = 5
CUT_OFF = "the run ended before it was measured, or measured to its end."


def bench(
    rounds: Annotated[
        int, typer.Option(min=1, help="Rounds; each measures every program once.")
    ] = 5,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GROUP",
            help="Group to measure (repeatable), with the approximate time of five rounds: "
            + ", ".join(f"{name} {group.takes}" for name, group in GROUPS.items())
            + ".",
        ),
    ] = None,
    everything: Annotated[
        bool,
        typer.Option(
            "--all",
            help=f"Measure {', '.join(LONG)} too: 22 minutes plus the recordings, instead of 7 "
            "minutes.",
        ),
    ] = False,
    peers: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Scripts of the peers (benchmarks/peers of the sources)."),
    ] = None,
    recordings: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            envvar="HANDCAL_RECORDINGS",
            help="Recordings of real devices (MCAP), for the group 'devices'.",
        ),
    ] = Path("../shared/recordings"),
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="An earlier file of --json: exit status 1 if a ratio is now 30 % worse.",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Measure handcal on this machine: speed beside other programs, start-up, memory.

    For whole commands it also shows where the time goes. Each figure is shown, and written to
    --json, as soon as it is measured; an interrupted bench keeps its figures. Other programs that
    are not installed are skipped; the extra 'bench' installs them.
    """
    from handcal.output import check_outputs

    folders = (peers, recordings) if everything or "devices" in (only or ()) else (peers,)
    check_outputs((json,), (against, *folders))
    earlier = _earlier(against) if against else None
    left = _chosen(only or (), everything)
    os.environ["OMP_NUM_THREADS"] = "1"
    measured = _measured(left, rounds, peers or _beside_the_sources(), recordings)
    found = _taken(measured, left, rounds, json)
    if earlier is not None:
        _check(found, earlier)


def _chosen(only: Sequence[str], everything: bool) -> list[str]:
    """The groups that are asked for, in their own order. Raises InputError."""
    from handcal.types import InputError

    for name in only:
        if name not in GROUPS:
            raise InputError(f"--only {name}: unknown group. Known: {', '.join(GROUPS)}.")
    return [g for g in GROUPS if g in only or (not only and (everything or g not in LONG))]


def _taken(measured: Iterator[Row], left: list[str], rounds: int, json: Path | None) -> Found:
    """All that is measured; each figure is shown and kept before the next is waited for. left:
    the groups that are not measured to their end yet."""
    from handcal.bench.document import document
    from handcal.show.calibration.summary import write_json
    from handcal.show.console import Terminal

    load = _load()
    found: Found = []
    # (standard output and pipes take one document, and that at the end)
    at_the_end = json is not None and (str(json) == "-" or (json.exists() and not json.is_file()))

    def keep() -> None:
        if json:
            write_json(document(found, _cut_off(left), rounds, load), json)

    console = Terminal(highlight=False, quiet=str(json) == "-")
    _show_heading(console, rounds, load)
    try:
        for row in measured:
            found.append(row)
            console.print(_line(row), soft_wrap=True)
            if not at_the_end:
                keep()
    except (KeyboardInterrupt, SystemExit) as ended:
        if found or at_the_end:  # (before the first figure an earlier file stays)
            keep()
        _say_interrupted(found, left, json)
        if isinstance(ended, SystemExit):
            raise
        raise typer.Exit(INTERRUPTED) from None
    left.clear()
    keep()
    return found


def _cut_off(groups: Sequence[str]) -> list[Skipped]:
    from handcal.bench.timing import Skipped

    return [Skipped(name, GROUPS[name].text, CUT_OFF) for name in groups]


def _say_interrupted(found: Found, left: Sequence[str], json: Path | None) -> None:
    from handcal.bench.timing import Figure

    count = sum(isinstance(row, Figure) for row in found)
    kept = f" and kept in {json}" if count and json and str(json) != "-" else ""
    figures = f"{count} figures are measured{kept}" if count else "nothing is measured yet"
    say(f"interrupted; {figures}; not measured to their end: {', '.join(left)}")


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


def _measured(left: list[str], rounds: int, peers: Path, recordings: Path) -> Iterator[Row]:
    """Each figure of these groups as soon as there is one; a group that is through leaves them."""
    from handcal.bench.timing import Missing, Skipped

    with (
        TemporaryDirectory(prefix="handcal-bench-") as name,
        progress("measuring", patience=0.0) as bar,
    ):
        measure = _measurements(Path(name), rounds, peers, recordings)
        groups = tuple(left)
        for k, group in enumerate(groups, 1):
            told = f"{group} ({k} of {len(groups)})"

            def tick(what: str = "", told: str = told) -> None:
                bar(stage=what and f"{told}: {what}")

            tick(GROUPS[group].text)
            try:
                for row in measure[group](tick):
                    bar.hide()
                    yield row
            except Missing as problem:
                bar.hide()
                yield Skipped(group, GROUPS[group].text, str(problem))
            left.remove(group)


def _measurements(
    folder: Path, rounds: int, peers: Path, recordings: Path
) -> dict[str, Callable[[Tick], Rows]]:
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


# ---- what is shown ----------------------------------------------------------------------------


def _show_heading(console: Console, rounds: int, load: float | None) -> None:
    text = "cpu: time of one thread on the processor; wall: by the clock."
    console.print(f"Medians of {rounds} rounds, the least and the most; {text}", soft_wrap=True)
    if load is not None and load > 0.5:
        console.print(
            f"This machine is busy (load {load:.1f} a core): wall-clock times are too long, and "
            "CPU times somewhat.", soft_wrap=True,
        )  # fmt: skip


def _line(row: Row) -> Text:
    """One line: median, unit and clock, least and most, what it is, what is asked."""
    from rich.text import Text

    from handcal.bench.timing import Profile, Skipped, shares

    if isinstance(row, Skipped):
        return Text(f"Left out: {row.title}: {row.reason}")
    if isinstance(row, Profile):
        largest = ", ".join(f"{name} {share:.0f} %" for name, share in shares(row.doing)[:SHOWN])
        return Text(f"{'':33} where it goes: {row.title}: {largest}", "dim")
    low, high = row.rounds.min(), row.rounds.max()
    spread = f"{_number(low)} to {_number(high)}" if len(row.rounds) > 1 else ""
    unit = f"{row.unit} {row.clock}".strip()
    out = Text(f"{_number(row.value):>8} {unit:<7} {spread:<16} ")
    out.append(row.title, "" if row.target else "dim")
    if row.target is not None:
        word = "at most" if row.target.at_most else "at least"
        out.append(f": {word} {_number(row.target.value)} asked, ")
        out.append(*(("met", "green") if row.met else ("missed", "red")))
    return out


def _number(value: float) -> str:
    """Three digits, none of them after a hundred."""
    if value >= 99.95:
        return f"{value:,.0f}"
    return f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"
