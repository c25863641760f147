"""The same recordings explained by another handcal program, and what either got right alone.

Two versions on recordings of their own differ by their recordings too; on the same ones only those
count that one of them got right and the other did not (McNemar's test).
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from handcal_sim.prove.given import Ticket
from handcal_sim.prove.run import Case, Explain, each
from handcal_sim.prove.score import outcome
from handcal_sim.prove.suites import SUITES
from handcal_sim.prove.trial import Document, Trial
from handcal_sim.prove.workers import Stopped, serve

# An explanation that takes longer than this is none, s.
PATIENCE_S = 1800.0


def explained_by(program: str, path: str) -> Document:
    """What ``PROGRAM explain`` says of a recording of a trial, as its user would call it; kept in
    the trial's folder."""
    recording = Path(path)
    file = recording.parents[1] / "against" / f"{recording.stem}.json"
    file.parent.mkdir(exist_ok=True)
    # (what this version is found by is not for the other one)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    try:
        done = subprocess.run(
            [program, "explain", path, "--json", str(file)], stdin=subprocess.DEVNULL, check=False,
            capture_output=True, text=True, timeout=PATIENCE_S, env=environment,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"error": f"no explanation within {PATIENCE_S:.0f} s"}
    if not file.exists():
        return {"error": done.stderr.strip() or f"status {done.returncode}"}
    document: Document = json.loads(file.read_text(encoding="utf-8"))
    return document


def again(
    trials: Sequence[Trial], cases: Sequence[Case], seed: int, folder: Path, explain: Explain,
    jobs: int, advance: Callable[[], None],
) -> list[Trial]:  # fmt: skip
    """The same trials with what another program says of their recordings. After an interrupt:
    those that it had explained by then."""
    from handcal_sim.prove.further import worked_out

    tickets = {name: Ticket(suite, number, seed) for name, suite, number in cases}

    def one(trial: Trial) -> Trial | None:
        try:
            document, taken = explain(folder / "recordings" / f"{trial.name}.mcap")
        except Stopped:
            return None
        further = worked_out(tickets[trial.name], document)
        return dataclasses.replace(trial, document=document, seconds=taken, further=further)

    return each(one, trials, explain, jobs, advance)


def compared(trials: Sequence[Trial], others: Sequence[Trial]) -> list[dict[str, Any]]:
    """By suite: how many both, one alone (this, the other) and neither got right, and how likely
    as uneven a division of those of one alone is if neither is better. What is too faint for
    either is not judged, nor what the other did not come to."""
    from scipy.stats import binomtest

    rows, by_name = [], {other.name: other for other in others}
    pairs = [(trial, by_name[trial.name]) for trial in trials if trial.name in by_name]
    for name in dict.fromkeys(trial.answer.suite for trial in trials):
        right = SUITES[name].right
        counts = {(a, b): 0 for a in (True, False) for b in (True, False)}
        for trial, other in pairs:
            said = outcome(trial), outcome(other)
            if trial.answer.suite == name and "too_faint" not in said:
                counts[said[0] in right, said[1] in right] += 1
        this, that = counts[True, False], counts[False, True]
        chance = float(binomtest(this, this + that).pvalue) if this + that else 1.0
        rows.append({
            "suite": name, "both": counts[True, True], "this_alone": this, "other_alone": that,
            "neither": counts[False, False], "chance": chance,
        })  # fmt: skip
    return rows


if __name__ == "__main__":
    serve(partial(explained_by, sys.argv[1]))
