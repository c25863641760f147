"""The command `prove`. What is slow to import is imported where it is used."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handcal_sim.commands._progress import progress
from handcal_sim.prove.run import ALL, Case, plan, run, with_limits, write_answers

# The suites that do something else than explain recordings one by one: what leads hands, and the
# devices of a fleet; how many hands and recordings at full size.
LIVE, LIVE_HANDS = "live", 200
FLEET, FLEET_RECORDINGS = "fleet", 2000

if TYPE_CHECKING:
    from handcal_sim.prove.trial import Trial
    from handcal_sim.prove.workers import Workers


def prove(
    n: Annotated[
        int | None,
        typer.Option(
            "--n",
            min=1,
            help="Number of recordings; if not given 24, or the full size of a suite that has one.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Same seed, same trial; random and printed if not given."),
    ] = None,
    suite: Annotated[
        str,
        typer.Option(
            help="nothing, one, mixed, unknown, turn, faint, reference, large, phone, odometry, "
            "people, budget, wild, strange, latest (the newest laws of strange), axis, "
            "walks, ordinary (all errors of a data sheet, short motions), or all (of the "
            "first five); live: hands guided by `handcal live`, beside hands without "
            "guidance; fleet: recordings of many devices, given to `handcal fleet`."
        ),
    ] = ALL,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Keep recordings, answers, explanations here."),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="The score as JSON.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Number of processes that explain.")] = 1,
    effects_from: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Explain with the effect files (*.py) of this folder in the catalogue. This runs "
            "their code: name no folder that you do not trust.",
        ),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="HANDCAL",
            help="Another handcal program (an older version's .venv/bin/handcal): it explains "
            "the same recordings, and what only one of the two gets right is counted.",
        ),
    ] = None,
) -> None:
    """Run a blind trial of explain: conceal random errors in random recordings, explain, score."""
    from handcal.commands._options import say_what_runs
    from handcal.user_effects import effects_from as also

    if effects_from is not None:
        say_what_runs(effects_from)
    with also(effects_from):
        _proved(n, seed, suite, out, json_file, jobs, effects_from, against)


def _proved(
    n: int | None, seed: int | None, suite: str, out: Path | None, json_file: Path | None,
    jobs: int, effects_from: Path | None, against: str | None,
) -> None:  # fmt: skip
    from rich.console import Console

    from handcal.commands._registry import say
    from handcal.output import check_outputs, write_text
    from handcal.user_effects import files
    from handcal_sim.prove.paired import compared
    from handcal_sim.prove.score import score
    from handcal_sim.prove.show import show

    read = files(effects_from) if effects_from else ()
    check_outputs((json_file,), (*read, Path(against) if against else None))
    if suite in (LIVE, FLEET):
        _led(n, seed, json_file) if suite == LIVE else _fleet(n, seed, out, json_file, jobs)
        return
    _check(suite, against)
    seed = _drawn(seed)
    cases = plan(suite, n, seed)
    say(f"{len(cases)} recordings, seed {seed}")
    with _folder(out) as folder:
        own = [] if effects_from is None else [str(effects_from.absolute())]
        with (
            _workers(["handcal_sim.prove", *own], jobs) as workers,
            progress(len(cases), "explaining", "explained") as advance,
        ):
            trials = run(cases, seed, folder, workers, jobs, lambda: advance(1))
        write_answers(trials, seed, folder / "answers.json")
        trials = [with_limits(trial, folder) for trial in trials]
        others = [] if against is None else _others(against, trials, cases, seed, folder, jobs)
    if len(trials) < len(cases):
        say(f"interrupted: what follows is of {len(trials)} recordings")
    proof = score(trials, seed)
    if against is not None and len(others) < len(trials):
        say(f"interrupted: the other program explained {len(others)} of them")
    if others:
        proof |= {"against": score(others, seed), "paired": compared(trials, others)}
    if json_file is not None:
        write_text(json_file, json.dumps(proof, indent=1) + "\n")
    show(proof, Console(highlight=False))


def _drawn(seed: int | None) -> int:
    """The seed that was asked for, or a random one."""
    from numpy.random import SeedSequence

    return int(SeedSequence().generate_state(1)[0]) if seed is None else seed


def _check(suite: str, against: str | None) -> None:
    """Errors: InputError for a suite or a program that is not there."""
    from handcal.types import InputError
    from handcal_sim.prove.suites import SUITES

    if against is not None and shutil.which(against) is None:
        raise InputError(f"--against {against}: there is no such program. Name an executable file.")
    if suite not in (ALL, *SUITES):
        raise InputError(f"--suite {suite}: unknown suite. Known: {', '.join((*SUITES, ALL))}.")


def _fleet(
    n: int | None, seed: int | None, out: Path | None, json_file: Path | None, jobs: int
) -> None:
    """A fleet whose truth is known."""
    from handcal.commands._registry import say
    from handcal.output import write_text
    from handcal_sim.prove.fleet import lines, run

    seed = _drawn(seed)
    n = FLEET_RECORDINGS if n is None else n
    say(f"a fleet of {n} recordings, seed {seed}")
    with _folder(out) as folder:
        found = run(n, seed, folder, jobs)
    if json_file is not None:
        write_text(json_file, json.dumps(found, indent=1) + "\n")
    print("\n".join(lines(found)))


def _led(n: int | None, seed: int | None, json_file: Path | None) -> None:
    """Hands that are led beside hands that are not."""
    from handcal.commands._registry import say
    from handcal.output import write_text
    from handcal_sim.prove.live import lines, run

    seed = _drawn(seed)
    n = LIVE_HANDS if n is None else n
    say(f"{n} hands, seed {seed}")
    with progress(n, "leading", "led") as advance:
        found = run(n, seed, lambda: advance(1))
    if json_file is not None:
        write_text(json_file, json.dumps(found, indent=1) + "\n")
    print("\n".join(lines(found)))


def _others(
    against: str, trials: Sequence[Trial], cases: Sequence[Case], seed: int, folder: Path,
    jobs: int,
) -> list[Trial]:  # fmt: skip
    """The same trials by another program."""
    from handcal_sim.prove.paired import again

    with (
        _workers(["handcal_sim.prove.paired", against], jobs) as workers,
        progress(len(trials), "explaining again", "explained again") as advance,
    ):
        others = again(trials, cases, seed, folder, workers, jobs, lambda: advance(1))
    return [with_limits(other, folder) for other in others]


@contextmanager
def _workers(module: Sequence[str], jobs: int) -> Iterator[Workers]:
    """Processes of a module and its arguments, which end with what is done with them."""
    from handcal_sim.prove.workers import Workers

    workers = Workers([sys.executable, "-m", *module], jobs)
    try:
        yield workers
    finally:
        workers.stop()


@contextmanager
def _folder(out: Path | None) -> Iterator[Path]:
    """Where to write: a folder that is kept, which must hold no other trial, or one that is not."""
    from handcal.types import InputError

    if out is None:
        with tempfile.TemporaryDirectory(prefix="handcal-prove-") as name:
            yield Path(name)
        return
    if (out / "recordings").exists() or (out / "answers.json").exists():
        raise InputError(f"{out} holds a trial already: name another folder.")
    out.mkdir(parents=True, exist_ok=True)
    yield out
