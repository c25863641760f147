"""The same recordings explained by another handcal program, and what either got right alone.

Two versions on recordings of their own differ by their recordings too; on the same ones only those
count that one of them got right and the other did not (McNemar's test).
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from handcal_sim.prove.given import Ticket
from handcal_sim.prove.run import Case, Explain, with_limits
from handcal_sim.prove.score import outcome
from handcal_sim.prove.suites import SUITES
from handcal_sim.prove.trial import Trial

# An explanation that takes longer than this is none, s.
PATIENCE_S = 1800.0


def program(command: Sequence[str]) -> Explain:
    """``handcal explain`` of that program, as its user would call it."""

    def explain(path: Path) -> tuple[Mapping[str, Any], float]:
        # (what this version is found by is not for the other one)
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        with tempfile.TemporaryDirectory(prefix="handcal-prove-") as name:
            file = Path(name) / "explanation.json"
            started = time.perf_counter()
            try:
                done = subprocess.run(
                    [*command, "explain", str(path), "--json", str(file)], check=False,
                    capture_output=True, text=True, timeout=PATIENCE_S, env=environment,
                )  # fmt: skip
            except subprocess.TimeoutExpired:
                return {"error": f"no explanation within {PATIENCE_S:.0f} s"}, PATIENCE_S
            taken = time.perf_counter() - started
            if not file.exists():
                return {"error": done.stderr.strip() or f"status {done.returncode}"}, taken
            return json.loads(file.read_text(encoding="utf-8")), taken

    return explain


def again(
    trials: Sequence[Trial], cases: Sequence[Case], seed: int, folder: Path, explain: Explain,
    jobs: int, advance: Callable[[], None],
) -> list[Trial]:  # fmt: skip
    """The same trials with what another program says of their recordings. After an interrupt:
    those that it had explained by then."""
    from handcal_sim.prove.further import worked_out

    tickets = {name: Ticket(suite, number, seed) for name, suite, number in cases}
    kept = folder / "against"
    kept.mkdir()

    def one(trial: Trial) -> Trial:
        document, taken = explain(folder / "recordings" / f"{trial.name}.mcap")
        (kept / f"{trial.name}.json").write_text(json.dumps(document), encoding="utf-8")
        further = {} if "error" in document else worked_out(tickets[trial.name], document)
        advance()
        other = dataclasses.replace(
            trial, document=document, seconds=taken, further=further, expected={}
        )
        return with_limits(other, folder)

    with ThreadPoolExecutor(jobs) as pool:
        futures = [pool.submit(one, trial) for trial in trials]
        try:
            for future in futures:
                future.result()
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
    ended = [f for f in futures if f.done() and not f.cancelled()]
    return [f.result() for f in ended if f.exception() is None]


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
