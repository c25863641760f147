"""Explanations handed on by their JSON alone: what went through, was refused, or failed.

    python benchmarks/hand_over.py FOLDER... [--only NAME] [--json FILE]

FOLDER: what ``judge.py --keep FOLDER`` wrote. Each explanation goes with its recording through
``apply --from``, ``calibrate --from`` and ``conceal --from``, and alone through ``export`` in every
format. A refusal is a sentence; whatever else ends a command is a failure, and so is a calibration
that has lost an effect of the model or differs from the explanation by a tenth of a sigma.
"""

from __future__ import annotations

import argparse
import json
import re
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from judge_cases import ROOT, SEED, Case, cases, written
from rich.console import Console
from rich.table import Table
from typer.testing import CliRunner

from handcal.commands import _app
from handcal.exports import formats
from handcal.output import write_text

THROUGH, REFUSED, FAILED = "through", "refused", "failed"
# What every recording of an IMU can hold, by no more than is usual.
HIDDEN = "gyro_scale=0.001,0,0"
SAME = 0.1  # sigma

Row = tuple[str, str, str, str]  # explanation, hand-over, what became of it, why


def handed(case: Case, explanation: Path, folder: Path) -> Iterator[Row]:
    """A row for each hand-over of an explanation."""
    file, _ = written(case, folder)
    model, calibration = ["--from", str(explanation)], folder / "calibration.json"
    ways = {
        "apply": ["apply", str(file), *model, "-o", str(folder / "applied.mcap")],
        "calibrate": ["calibrate", str(file), *model, "--json", str(calibration)],
        "conceal": ["conceal", str(file), *model, "--effect", HIDDEN, "--seed", "0",
                    "-o", str(folder / "concealed.mcap")],
    }  # fmt: skip
    ways |= {
        f"export {form}": ["export", str(explanation), "--to", form, "-o", str(folder / form)]
        for form in formats()
    }
    for way, words in ways.items():
        outcome, why = _ended(words)
        if way == "calibrate" and outcome == THROUGH:
            outcome, why = _repeated(_read(explanation), _read(calibration))
        yield case.name, way, outcome, why


def _ended(words: Sequence[str]) -> tuple[str, str]:
    """How a command ended, and the sentence or the last lines that say why."""
    done = CliRunner().invoke(_app.app, words)
    if done.exit_code == 0:
        return THROUGH, ""
    said = done.stderr.strip().splitlines()
    if isinstance(done.exception, SystemExit) and said and done.exit_code in (1, 2):
        return REFUSED, re.sub(r"\S*/", "", said[-1])
    return FAILED, "".join(traceback.format_exception(done.exception)[-3:])


def _repeated(explanation: Mapping[str, Any], calibration: Mapping[str, Any]) -> tuple[str, str]:
    """Whether a calibration has the model and the numbers of the explanation."""
    before, after = (_ids(d["model"]) for d in (explanation, calibration))
    if before != after:
        return FAILED, f"another model: {', '.join(sorted(before ^ after))}"
    then, now = (
        {(p["effect"], p["name"]): p for p in d["parameters"]} for d in (explanation, calibration)
    )
    off = {
        k: abs(p["value"] - now[k]["value"]) / p["sigma"]
        for k, p in then.items()
        if k in now and p["sigma"]
    }
    worst = max(off, key=lambda k: off[k])
    if off[worst] > SAME:
        return FAILED, f"{' '.join(worst)} is another by {off[worst]:.1f} sigma"
    return THROUGH, ""


def _ids(model: Mapping[str, Any]) -> set[str]:
    return {*(e["id"] for e in model["effects"]), *model["noise_effects"]}


def _read(file: Path) -> dict[str, Any]:
    return dict(json.loads(file.read_text(encoding="utf-8")))


def show(rows: Sequence[Row], console: Console) -> None:
    """The table, and each refusal or failure with the explanations that had it."""
    table = Table("hand-over", THROUGH, REFUSED, FAILED)
    for way in dict.fromkeys(row[1] for row in rows):
        count = Counter(outcome for _, w, outcome, _ in rows if w == way)
        table.add_row(way, *(str(count[word]) for word in (THROUGH, REFUSED, FAILED)))
    console.print(table)
    said: dict[tuple[str, str, str], list[str]] = {}
    for name, way, outcome, why in rows:
        if outcome != THROUGH:
            said.setdefault((outcome, way, why.replace(name, "*")), []).append(name)
    for (outcome, way, why), names in sorted(said.items()):
        console.print(f"{way}, {outcome}, {len(names)} ({', '.join(names[:4])}): {why}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--only", action="append", help="the explanation of this name")
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--json", type=Path, help="the rows as a file")
    options = parser.parse_args()
    rows: list[Row] = []
    for case in cases(SEED, options.shared / "recordings"):
        for folder in options.folders:
            explanation = folder / f"{case.name}.json"
            if explanation.exists() and case.name in (options.only or (case.name,)):
                with TemporaryDirectory(prefix="handcal-hand-over-") as scratch:
                    rows += handed(case, explanation, Path(scratch))
                bad = [f"{way} {what}" for name, way, what, _ in rows
                       if name == case.name and what != THROUGH]  # fmt: skip
                print(f"{case.name}: {', '.join(bad) or 'all through'}", flush=True)
                if options.json is not None:
                    write_text(options.json, json.dumps(rows, indent=0) + "\n")
    show(rows, Console(highlight=False))


if __name__ == "__main__":
    main()
