"""The net under rewritten searches and estimators: 120 recordings explained, row by row.

    python benchmarks/judge.py [--quick] [--resume] [--against TABLE] [--handcal PROGRAM] ...

Drawn recordings of the suites of ``handcal prove``, the sealed ones, and real ones beside the
checkout. Each is explained in a process of its own by this checkout, another one (a folder) or a
program. A row is written as soon as its recording has ended, so a run that broke off goes on with
``--resume``; those of ``--quick`` come first. ``--against`` pairs the rows of another table.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import judge_compare
from judge_cases import ROOT, SEED, Case, cases, written
from judge_rows import Row, row_of
from rich.console import Console

from handcal.output import write_text
from handcal_sim.prove.run import each
from handcal_sim.prove.workers import Stopped, Workers

TIMEOUT_S = 900.0
_LOOK_S = 0.05


class Explainer(Workers):
    """A new process for each recording, of so many at once; says what it has spent as well."""

    def __init__(
        self, program: Path, timeout_s: float, count: int, keep: Path | None = None
    ) -> None:
        # (on one thread of algebra however many there are, so that times compare)
        super().__init__([str(program), "explain"], max(count, 2))
        self.timeout_s, self.keep = timeout_s, keep
        self.environment.pop("PYTHONPATH", None)
        if program.is_dir():
            self.command = [sys.executable, "-m", "handcal", "explain"]
            own = (str(program / part) for part in ("src", "sim"))
            self.environment["PYTHONPATH"] = os.pathsep.join(own)

    def __call__(self, path: Path) -> tuple[Mapping[str, Any], float]:
        with tempfile.TemporaryDirectory(prefix="handcal-judge-") as folder:
            return self._explained(path, Path(folder))

    def _explained(self, path: Path, folder: Path) -> tuple[Mapping[str, Any], float]:
        out, said = folder / "explanation.json", folder / "said"
        with said.open("wb") as errors:
            begun = time.monotonic()
            process = subprocess.Popen(
                [*self.command, str(path), "--json", str(out)], stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL, stderr=errors, cwd=folder, env=self.environment,
                start_new_session=True,
            )  # fmt: skip
        self.running.add(process)
        late, pid = False, 0
        while not pid:
            time.sleep(_LOOK_S)
            try:
                pid, status, used = os.wait4(process.pid, os.WNOHANG)
            except ChildProcessError:  # `stop` was there before
                raise Stopped from None
            if not (pid or late) and time.monotonic() - begun > self.timeout_s:
                late = True
                os.killpg(process.pid, 9)
        taken = time.monotonic() - begun
        process.returncode = os.waitstatus_to_exitcode(status)
        self.running.discard(process)
        if self.stopped:
            raise Stopped
        spent = {"processor_s": used.ru_utime + used.ru_stime}
        if late:
            return {"error": f"no explanation within {self.timeout_s:.0f} s", **spent}, taken
        if not out.exists():
            lines = said.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            last = lines[-1] if lines else f"status {process.returncode}"
            return {"error": last.replace(str(path), path.name)[:300], **spent}, taken
        if self.keep is not None:
            write_text(self.keep / f"{path.stem}.json", out.read_text(encoding="utf-8"))
        return {**json.loads(out.read_text(encoding="utf-8")), **spent}, taken


def judged(case: Case, explain: Explainer) -> Row | None:
    """The row of a recording; None after an interrupt."""
    with tempfile.TemporaryDirectory(prefix="handcal-judge-") as folder:
        file, answer = written(case, Path(folder))
        try:
            document, taken = explain(file)
        except Stopped:
            return None
        try:
            return row_of(case, file, answer, document, taken)
        except Exception as problem:  # a document as nobody expected it; the others go on
            said = f"cannot be scored: {problem!r}"
            kept = {"error": said, "processor_s": document["processor_s"]}
            return row_of(case, file, answer, kept, taken)


def run(
    asked: Sequence[Case], explain: Explainer, jobs: int, table: Path, rows: dict[str, Row]
) -> None:
    """Add what is not there yet to the rows, and to the table after each."""
    order = [case.name for case in asked]
    left = [case for case in asked if case.name not in rows]

    def one(case: Case) -> Row | None:
        row = judged(case, explain)
        if row is not None:
            rows[case.name] = row
            print(f"{len(rows)} of {len(order)} {case.name}: {row['outcome'] or row['verdict']}, "
                  f"{row['seconds']:.0f} s", flush=True)  # fmt: skip
        return row

    def keep() -> None:
        places = {name: k for k, name in enumerate(order)}
        done = sorted(rows.copy().values(), key=lambda r: places.get(r["name"], len(places)))
        write_text(table, table_of(done))

    try:
        each(one, left, explain, jobs, keep)
    finally:
        explain.stop()
        keep()


def table_of(rows: Sequence[Row]) -> str:
    """JSON, a row a line."""
    return "[\n" + ",\n".join(json.dumps(row, sort_keys=True) for row in rows) + "\n]\n"


def read(table: Path) -> dict[str, Row]:
    """The rows of a table by name."""
    return {row["name"]: row for row in json.loads(table.read_text(encoding="utf-8"))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a part of each suite: ten minutes")
    parser.add_argument("--suite", action="append", help="this one alone (and others named so)")
    parser.add_argument("--resume", action="store_true", help="go on with the table that is there")
    parser.add_argument("--table", type=Path, default=Path("judge-out/judge.json"))
    parser.add_argument("--against", type=Path, help="a table to compare with")
    parser.add_argument("--json", type=Path, help="the figures that are shown, as a file")
    parser.add_argument("--handcal", type=Path, default=ROOT,
                        help="what explains: a checkout's folder, or a program")  # fmt: skip
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--keep", type=Path, metavar="FOLDER",
                        help="keep each explanation: what hand_over.py tries")  # fmt: skip
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--timeout", type=float, default=TIMEOUT_S, help="s")
    options = parser.parse_args()
    if options.table.exists() and not options.resume:
        parser.error(f"{options.table} is there: remove it, or go on with it (--resume)")
    if not options.handcal.exists():
        parser.error(f"there is no {options.handcal}")
    other = read(options.against) if options.against else None
    asked = cases(options.seed, options.shared / "recordings")
    if not any(case.suite == "real" for case in asked):
        print(f"no real recordings in {options.shared / 'recordings'}: left out", file=sys.stderr)
    asked = [case for case in asked if case.quick or not options.quick]
    asked = [case for case in asked if case.suite in (options.suite or (case.suite,))]
    rows = read(options.table) if options.table.exists() else {}
    options.table.absolute().parent.mkdir(parents=True, exist_ok=True)
    if options.keep is not None:
        options.keep.mkdir(parents=True, exist_ok=True)
    explain = Explainer(options.handcal.absolute(), options.timeout, options.jobs, options.keep)
    run(asked, explain, options.jobs, options.table, rows)
    names = {case.name for case in asked}
    figures = judge_compare.compared({n: r for n, r in rows.items() if n in names}, other)
    judge_compare.show(figures, Console(highlight=False))
    if options.json is not None:
        write_text(options.json, json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
