"""`calibrate` on ordinary devices: `python -m handcal_sim.prove.ordinary --n 60 --seed 1`.

The quick companion of `handcal prove --suite ordinary`, which explains the same recordings: it asks
whether all numbers are as good as is said, whichever names a search would choose.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from handcal_sim.effects import EFFECTS
from handcal_sim.mcap_writer import write
from handcal_sim.prove import ordinary_apply, ordinary_numbers
from handcal_sim.prove.draw import draw
from handcal_sim.prove.draw_ordinary import COLDEST, SUITE, WARMEST, case_of
from handcal_sim.prove.given import Ticket
from handcal_sim.prove.ordinary_devices import KINDS, SLOPES, SPREADS, spread
from handcal_sim.prove.ordinary_numbers import (
    BY,
    coverage,
    deviations,
    line,
    parts,
    rare,
    worst,
)
from handcal_sim.prove.ordinary_worker import AGAIN, CORRECTED, PRIORS
from handcal_sim.prove.run import each, write_answers
from handcal_sim.prove.score import seconds
from handcal_sim.prove.show_ordinary import tables
from handcal_sim.prove.trial import Trial
from handcal_sim.prove.workers import Stopped, Workers

WORST = 15


@dataclasses.dataclass(frozen=True)
class Asked:
    """The command line: numbers of the recordings, their seed, and how they are calibrated."""

    numbers: Sequence[int]
    seed: int
    jobs: int
    effects: str
    drawing_priors: bool
    apply: bool


def run(asked: Asked, folder: Path) -> list[Trial]:
    """Every recording calibrated, in the order of the numbers; after an interrupt, those done."""
    for kind in KINDS:
        (folder / _word(kind) / AGAIN).mkdir(parents=True)
        if asked.drawing_priors:
            write_priors(kind, folder / _word(kind) / PRIORS)
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        if sys.stderr.isatty() or done % 10 == 0:
            end = "\r" if sys.stderr.isatty() else "\n"
            print(
                f"{done} of {len(asked.numbers)} calibrated", end=end, file=sys.stderr, flush=True
            )

    command = [sys.executable, "-m", "handcal_sim.prove.ordinary_worker", asked.effects]
    workers = Workers(command, asked.jobs)
    try:
        trials = each(lambda number: _one(number, asked, folder, workers), asked.numbers, workers,
                      asked.jobs, advance)  # fmt: skip
    finally:
        workers.stop()
    return trials


def _one(number: int, asked: Asked, folder: Path, workers: Workers) -> Trial | None:
    world, answer = draw(SUITE, number, asked.seed)
    of_kind, name = folder / _word(answer.circumstances["kind"]), f"{number:04d}.mcap"
    write(world, of_kind / name, truth=False)
    del world
    case = case_of(Ticket(SUITE, number, asked.seed))
    if asked.apply:
        write(ordinary_apply.another(case), of_kind / AGAIN / name, truth=False)
    try:
        document, taken = workers(of_kind / name)
    except Stopped:
        return None
    further = {}
    if asked.apply and "error" not in document:
        corrected = of_kind / CORRECTED / name
        further = ordinary_apply.left(
            case, corrected if corrected.exists() else of_kind / AGAIN / name
        )
        foreseen = corrected.with_suffix(".json")
        if foreseen.exists():
            further |= json.loads(foreseen.read_text(encoding="utf-8"))
    return Trial(f"{number:04d}", answer, document, taken, further=further)


def write_priors(kind: str, path: Path) -> None:
    """The densities that the devices of a class are drawn from, as a file of priors."""
    from handcal.device.priors import Learned
    from handcal.device.priors import write as write_file

    warmth = (WARMEST - COLDEST) / math.sqrt(12.0)
    known = {}
    for effect in SPREADS:
        size = spread(kind, effect)
        if effect in SLOPES:
            # (that of a recording's mean temperature)
            size = math.hypot(size, warmth * spread(kind, SLOPES[effect]))
        for parameter in EFFECTS[effect]:
            known[effect, parameter.name] = Learned(0.0, 0.0, size, 0.0, math.inf, 1000)
    write_file(path, {kind: known}, {kind: {"recordings": 1000, "devices": 1000}})


def _word(kind: str) -> str:
    """A class as the name of a folder."""
    return kind.replace(" ", "-")


def result(trials: Sequence[Trial], asked: Asked) -> dict[str, Any]:
    """Everything that is shown, ready for JSON."""
    found = deviations(trials)
    plain = [d for d in found if not rare(d.trial)] or found
    return {
        "seed": asked.seed,
        "numbers": list(asked.numbers),
        "effects": asked.effects,
        "drawing_priors": asked.drawing_priors,
        "asked": ordinary_numbers.asked(coverage(plain), asked.drawing_priors),
        "coverage": coverage(plain),
        "by": {name: parts(found if name == "besides" else plain, of) for name, of in BY.items()},
        "worst": [line(d) for d in worst(plain, WORST)],
        "apply": ordinary_apply.score([t for t in trials if not rare(t)] or trials),
        "left": ordinary_apply.rows(trials),
        "seconds": seconds(trials),
        "failed": {t.name: t.document["error"] for t in trials if "error" in t.document},
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="handcal_sim.prove.ordinary", description=__doc__)
    parser.add_argument("--n", type=int, default=18, help="recordings (18)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, metavar="NUMBER", help="this recording alone")
    parser.add_argument(
        "--keep", type=Path, metavar="DIR", help="keep recordings, answers, results"
    )
    parser.add_argument("--effects", default="", metavar="ID,...|common",
                        help="what calibrate is told to estimate (nothing)")  # fmt: skip
    parser.add_argument("--with-drawing-priors", action="store_true",
                        help="--priors of the densities that devices are drawn from")  # fmt: skip
    parser.add_argument("--apply", action="store_true",
                        help="correct another recording of each device")  # fmt: skip
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="OUT")
    typed = parser.parse_args(arguments)
    numbers = range(typed.n) if typed.only is None else [typed.only]
    asked = Asked(numbers, typed.seed, typed.jobs, typed.effects, typed.with_drawing_priors,
                  typed.apply)  # fmt: skip
    with _folder(typed.keep) as folder:
        trials = run(asked, folder)
        write_answers(trials, asked.seed, folder / "answers.json")
    found = result(trials, asked)
    if typed.json:
        typed.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    for piece in tables(found):
        Console(highlight=False, width=140).print(piece)


@contextmanager
def _folder(kept: Path | None) -> Iterator[Path]:
    if kept is not None:
        kept.mkdir(parents=True)
        yield kept
        return
    with tempfile.TemporaryDirectory(prefix="handcal-ordinary-") as name:
        yield Path(name)


if __name__ == "__main__":
    main()
