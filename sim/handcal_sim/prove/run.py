"""A blind trial of `explain`. It sees both sides, but never at once.

Hidden effects are drawn, recordings are written without their truth and explained by other
processes, which are told paths only. Answers stay in this process's memory until the last
explanation has been given; only then are they written and compared.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from contextvars import copy_context
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from handcal_sim.prove.trial import Trial
    from handcal_sim.scenario import World

ALL = "all"
_FEW = 24
# Of the recordings of a mixture, these shares. `faint` asks for more than recordings.
_SHARES = {"nothing": 6, "one": 7, "mixed": 5, "unknown": 4, "turn": 2}
Case = tuple[str, str, int]
Explain = Callable[[Path], tuple[Mapping[str, Any], float]]
Item = TypeVar("Item")


def plan(suite: str, n: int | None, seed: int) -> list[Case]:
    """Name, suite and number of each recording; names and order tell nothing of suites."""
    import numpy as np

    from handcal_sim.prove.suites import SUITES

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
    from handcal.output import write_text
    from handcal_sim.mcap_writer import write
    from handcal_sim.prove.draw import draw
    from handcal_sim.prove.further import worked_out
    from handcal_sim.prove.given import Ticket
    from handcal_sim.prove.told import told
    from handcal_sim.prove.trial import Trial
    from handcal_sim.prove.workers import Stopped

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
        write_text(explanations / f"{name}.json", json.dumps(document))
        ticket = Ticket(suite, number, seed)
        further = worked_out(ticket, document)
        further |= told(ticket, answer, file, further)
        return Trial(name, answer, document, taken, further=further)

    return each(one, cases, explain, jobs, advance)


def each(
    work: Callable[[Item], Trial | None], items: Sequence[Item], explain: Explain, jobs: int,
    advance: Callable[[], None],
) -> list[Trial]:  # fmt: skip
    """What comes of each item, some at a time, with what explains them. After an interrupt: of
    those that had ended by then."""
    from handcal_sim.prove.workers import Workers

    with ThreadPoolExecutor(jobs) as pool:
        futures = [pool.submit(copy_context().run, work, item) for item in items]
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
    """Write the answers, after all explanations are done."""
    from handcal.output import write_text

    answers = {trial.name: dataclasses.asdict(trial.answer) for trial in trials}
    document = {"schema": "handcal-sim/answers/1", "seed": seed, "recordings": answers}
    write_text(file, json.dumps(document, indent=1) + "\n")


def explained(path: str) -> Mapping[str, Any]:
    """What `handcal explain --json` says of one recording."""
    import handcal
    from handcal.explain import explain
    from handcal.show.explanation.document import explanation_json

    return explanation_json(explain([handcal.load(path)]))


# ---- HOOK: handcal.explain.expected_gain.expected_gain(recording, effect_id, values) -> nats ----
def expected_gain(file: Path, effect: str, values: Sequence[float]) -> float:
    """Nats that an effect of this size promises in a recording, from its information matrix."""
    import handcal
    from handcal.types import HandcalError

    try:
        hook = import_module("handcal.explain.expected_gain").expected_gain
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
    from handcal_sim.prove.score import outcome
    from handcal_sim.prove.trial import matched, named

    if outcome(trial) != "missed" or trial.answer.stranger:
        return trial
    seen = matched(trial.answer.effects, named(trial.document))
    file = folder / "recordings" / f"{trial.name}.mcap"
    try:
        expected = {
            name: expected_gain(file, name, list(values.values()))
            for name, values in trial.answer.effects.items()
            if name not in seen and name not in trial.expected
        }
    except Exception:  # the trial stands without it
        return trial
    return dataclasses.replace(trial, expected={**trial.expected, **expected})
