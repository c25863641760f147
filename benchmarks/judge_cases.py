"""The recordings of `make judge`: drawn, sealed, and real ones beside the checkout."""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from handcal_sim.mcap_writer import write
from handcal_sim.prove.draw import draw
from handcal_sim.prove.run import promised
from handcal_sim.prove.suites import Answer
from handcal_sim.scenario import World

ROOT = Path(__file__).resolve().parents[1]
HERE = ROOT / "benchmarks"
SEED = 0
# Of each suite so many; of these the first two are in a quick run, of slow ones the first.
DRAWN = {
    "nothing": 8, "one": 5, "mixed": 5, "unknown": 5, "turn": 5, "faint": 8, "reference": 5,
    "large": 5, "phone": 3, "odometry": 3, "people": 8, "budget": 3, "wild": 5, "strange": 8,
    "axis": 5, "walks": 5,
}  # fmt: skip
SLOW = ("large", "phone", "odometry", "budget", "walks")
# Nothing, something outside the catalogue, what cannot be told apart, two effects.
QUICK_SEALED = ("sealed_01", "sealed_03", "sealed_04", "sealed_06")
QUICK_REAL = ("sensor_logger_ios", "broad_32_magnet", "array_6_imu5", "android_fullpitch",
              "phone_oscillations3")  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A recording. seed and number: of a drawn one; file: of another, and what is known of it: an
    answer, or an entry of known.toml."""

    name: str
    suite: str
    quick: bool
    seed: int = SEED
    number: int = 0
    file: Path | None = None
    known: Mapping[str, Any] = field(default_factory=dict)


def cases(seed: int, real: Path) -> list[Case]:
    """All of them: what a quick run needs first, all else evenly mixed."""
    suites = [_drawn(suite, n, seed) for suite, n in DRAWN.items()]
    suites += [_sealed(), _real(real)]
    placed = [
        (not case.quick, (k + 0.5) / len(suite), case)
        for suite in suites
        for k, case in enumerate(suite)
    ]
    return [case for *_, case in sorted(placed, key=lambda p: p[:2])]


def written(case: Case, folder: Path) -> tuple[Path, Answer | None]:
    """The file of a recording, and what is right of it; of a real one there is no answer."""
    if case.file is not None:
        return case.file, Answer(**case.known) if case.suite == "sealed" else None
    file = folder / f"{case.name}.mcap"
    world, answer = draw(case.suite, case.number, case.seed, _gain(case))
    write(world, file, truth=False)
    return file, answer


def _drawn(suite: str, n: int, seed: int) -> list[Case]:
    quick = 1 if suite in SLOW else 2
    return [Case(f"{suite}_{seed}_{k}", suite, k < quick, seed, k) for k in range(n)]


def _sealed() -> list[Case]:
    folder = ROOT / "recordings"
    answers = json.loads((folder / "answers.json").read_text(encoding="utf-8"))["recordings"]
    return [
        Case(Path(name).stem, "sealed", Path(name).stem in QUICK_SEALED, file=folder / name,
             known=answer)
        for name, answer in answers.items()
    ]  # fmt: skip


def _real(folder: Path) -> list[Case]:
    """Those that are there, of which known.toml and the gallery's table tell; short ones first."""
    listed = [
        entry
        for table in (HERE / "known.toml", ROOT / "docs" / "gallery" / "recordings.toml")
        for entry in tomllib.loads(table.read_text(encoding="utf-8"))["recording"]
    ]
    found = []
    for entry in listed:
        file = folder / entry["file"]
        known = entry if "known" in entry else {**entry, "known": _tested(file.stem)}
        if file.exists():
            quick = file.stem in QUICK_REAL
            found.append(Case(file.stem, "real", quick, file=file.absolute(), known=known))
    return found


def _tested(name: str) -> list[dict[str, Any]]:
    """What the tests of real devices know of a recording."""
    if str(ROOT / "tests") not in sys.path:
        sys.path.append(str(ROOT / "tests"))
    from test_real_devices import FACTS

    return [asdict(fact) for fact in FACTS.get(name, ())]


def _gain(case: Case) -> Any:
    """What an effect promises. In recordings of the usual seed this follows the sizes that were
    once found (faint.json): the same recordings, whatever `expected_gain` says today."""
    kept = json.loads((HERE / "faint.json").read_text(encoding="utf-8"))
    if case.suite != "faint" or case.seed != SEED or str(case.number) not in kept:
        return promised
    one = kept[str(case.number)]

    def gain(_world: World, effect: str, values: Sequence[float]) -> float:
        at_size = one["nats"] * (values[0] / one["first"]) ** 2
        return float(at_size) if effect == one["effect"] else 0.0

    return gain
