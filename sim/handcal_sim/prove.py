"""The command `prove`: a blind trial of `explain`. It sees both sides, but never at once.

Hidden effects are drawn, recordings are written without their truth and explained by other
processes, which are told paths only. Answers stay in this process's memory until the last
explanation has been given; only then are they written and compared.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from contextvars import copy_context
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from handcal_sim.prove_trial import Trial
    from handcal_sim.scenario import World

ALL = "all"
_FEW = 24
# Of the recordings of a mixture, these shares. `faint` asks for more than recordings.
_SHARES = {"nothing": 6, "one": 7, "mixed": 5, "unknown": 4, "turn": 2}
Case = tuple[str, str, int]
Explain = Callable[[Path], tuple[Mapping[str, Any], float]]


def prove(
    n: Annotated[
        int | None,
        typer.Option("--n", min=1, help="How many recordings (24; a suite's own: its full size)."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Same seed, same trial (drawn, and said).")
    ] = None,
    suite: Annotated[
        str,
        typer.Option(
            help="nothing, one, mixed, unknown, turn, faint, reference, large, phone, odometry, "
            "people, budget, wild, strange, or all (of the first five)."
        ),
    ] = ALL,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Keep recordings, answers, explanations here."),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="The score as JSON.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes that explain at a time.")] = 1,
    effects_from: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Explain with the effect files (*.py) of this folder in the catalogue. This runs "
            "their code: name no folder that you do not trust.",
        ),
    ] = None,
) -> None:
    """Conceal random errors in random recordings, explain them blindly, and score that."""
    from handcal.commands import say
    from handcal.own_effects import effects_from as also

    if effects_from is not None:
        say(f"running the code of {effects_from}/*.py, as --effects-from asks")
    with also(effects_from):
        _proved(n, seed, suite, out, json_file, jobs, effects_from)


def _proved(
    n: int | None, seed: int | None, suite: str, out: Path | None, json_file: Path | None,
    jobs: int, effects_from: Path | None,
) -> None:  # fmt: skip
    from numpy.random import SeedSequence
    from rich.console import Console

    from handcal.commands import say
    from handcal.types import InputError
    from handcal_sim.prove_score import score
    from handcal_sim.prove_show import show
    from handcal_sim.prove_suites import SUITES
    from handcal_sim.prove_workers import Workers

    if suite not in (ALL, *SUITES):
        raise InputError(f"--suite {suite}: there are {', '.join((*SUITES, ALL))}.")
    if seed is None:
        seed = int(SeedSequence().generate_state(1)[0])
    cases = plan(suite, n, seed)
    say(f"{len(cases)} recordings, seed {seed}")
    with _folder(out) as folder, _progress(len(cases)) as advance:
        own = [] if effects_from is None else [str(effects_from.absolute())]
        workers = Workers([sys.executable, "-m", "handcal_sim.prove", *own], jobs)
        try:
            trials = run(cases, seed, folder, workers, jobs, advance)
        finally:
            workers.stop()
        write_answers(trials, seed, folder / "answers.json")
        trials = [with_limits(trial, folder) for trial in trials]
    if len(trials) < len(cases):
        say(f"interrupted: what follows is of {len(trials)} recordings")
    proof = score(trials, seed)
    if json_file is not None:
        json_file.write_text(json.dumps(proof, indent=1) + "\n", encoding="utf-8")
    show(proof, Console(highlight=False))


def plan(suite: str, n: int | None, seed: int) -> list[Case]:
    """Name, suite and number of each recording; names and order tell nothing of suites."""
    import numpy as np

    from handcal_sim.prove_suites import SUITES

    if suite != ALL:
        drawn = [(suite, number) for number in range(n or SUITES[suite].full)]
    else:
        # Evenly mixed, so that the first of many are a mixture as well.
        places = [((k + 0.5) / share, name, k) for name, share in _SHARES.items()
                  for k in range(share * (n or _FEW))]  # fmt: skip
        drawn = [(name, number) for _, name, number in sorted(places)][: n or _FEW]
    order = np.random.default_rng([seed, 1]).permutation(len(drawn))
    return [(f"r{place + 1:04d}", *drawn[int(k)]) for place, k in enumerate(order)]


def run(
    cases: Sequence[Case], seed: int, folder: Path, explain: Explain, jobs: int,
    advance: Callable[[], None],
) -> list[Trial]:  # fmt: skip
    """Draw, write and explain. After an interrupt: what had been explained by then."""
    from handcal_sim.mcap_writer import write
    from handcal_sim.prove_draw import draw
    from handcal_sim.prove_further import worked_out
    from handcal_sim.prove_given import Ticket
    from handcal_sim.prove_trial import Trial
    from handcal_sim.prove_workers import Stopped, Workers

    recordings, explanations = folder / "recordings", folder / "explanations"
    recordings.mkdir(parents=True)
    explanations.mkdir()

    def one(case: Case) -> Trial | None:
        name, suite, number = case
        world, answer = draw(suite, number, seed, promised)
        file = recordings / f"{name}.mcap"
        write(world, file, truth=False)
        del world
        try:
            document, taken = explain(file)
        except Stopped:
            return None
        (explanations / f"{name}.json").write_text(json.dumps(document), encoding="utf-8")
        further = worked_out(Ticket(suite, number, seed), document)
        return Trial(name, answer, document, taken, further=further)

    with ThreadPoolExecutor(jobs) as pool:
        futures = [pool.submit(copy_context().run, one, case) for case in cases]
        try:
            for future in as_completed(futures):
                future.result()
                advance()
        except BaseException as problem:
            pool.shutdown(wait=False, cancel_futures=True)
            if isinstance(explain, Workers):
                explain.stop()
            if not isinstance(problem, KeyboardInterrupt | CancelledError):
                raise
    done = [future.result() for future in futures if future.done() and not future.cancelled()]
    return [trial for trial in done if trial is not None]


def write_answers(trials: Sequence[Trial], seed: int, file: Path) -> None:
    """The answers, once nobody has to guess them any more."""
    answers = {trial.name: dataclasses.asdict(trial.answer) for trial in trials}
    document = {"schema": "handcal-sim/answers/1", "seed": seed, "recordings": answers}
    file.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def explained(path: str) -> Mapping[str, Any]:
    """What `handcal explain --json` says of one recording."""
    import handcal
    from handcal.explain import explain
    from handcal.explain_summary import explanation_json

    return explanation_json(explain([handcal.load(path)]))


# ---- HOOK: handcal.explain.limits.expected_gain(recording, effect_id, values) -> nats --------
def expected_gain(file: Path, effect: str, values: Sequence[float]) -> float:
    """Nats that an effect of this size promises in a recording, from its information matrix."""
    import handcal
    from handcal.types import HandcalError

    try:
        hook = import_module("handcal.explain.limits").expected_gain
    except (ImportError, AttributeError):
        raise HandcalError("explain does not yet say what an effect promises.") from None
    return float(hook(handcal.load(file), effect, list(values)))


def promised(world: World, effect: str, values: Sequence[float]) -> float:
    """The same for a world that has not been written yet."""
    from handcal_sim.mcap_writer import write

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "plain.mcap"
        write(world, file, truth=False)
        return expected_gain(file, effect, values)


def with_limits(trial: Trial, folder: Path) -> Trial:
    """The trial with what was to be expected of those effects that were not named, if known."""
    from handcal_sim.prove_score import outcome
    from handcal_sim.prove_trial import matched, named

    if outcome(trial) != "missed" or trial.answer.stranger:
        return trial
    seen = matched(trial.answer.effects, named(trial.document))
    file = folder / "recordings" / f"{trial.name}.mcap"
    try:
        expected = {
            name: expected_gain(file, name, list(values.values()))
            for name, values in trial.answer.effects.items()
            if name not in seen
        }
    except Exception:  # the trial stands without it
        return trial
    return dataclasses.replace(trial, expected=expected)


# ----------------------------------------------------------------------------------------------


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


@contextmanager
def _progress(total: int) -> Iterator[Callable[[], None]]:
    """How far it is and the time left, on stderr: a bar, or a line now and then in a log."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeElapsedColumn as Elapsed
    from rich.progress import TimeRemainingColumn as Remaining

    from handcal.commands import say

    started = said = time.monotonic()
    done = 0
    columns = (TextColumn("explaining"), BarColumn(), MofNCompleteColumn(), Elapsed(),
               TextColumn("left"), Remaining())  # fmt: skip
    terminal = sys.stderr.isatty()
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not terminal) as bar:
        task = bar.add_task("", total=total)

        def advance() -> None:
            nonlocal done, said
            done += 1
            bar.advance(task)
            now = time.monotonic()
            if not terminal and now - said > 30.0:
                left = (now - started) / done * (total - done)
                say(f"{done} of {total} explained; about {left / 60:.0f} min left")
                said = now

        yield advance


if __name__ == "__main__":
    from handcal.own_effects import effects_from as also
    from handcal_sim.prove_workers import serve

    with also(Path(sys.argv[1]) if sys.argv[1:] else None):
        serve(explained)
