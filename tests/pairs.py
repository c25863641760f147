"""Two runs of a command at once that write the same files: each file whole, and one of the two.

``make pairs N=100`` takes the commands in turn, begins the second run at a random moment of the
first, and looks at every file of the folder. What either run writes alone is made first, twice: a
file that comes out the same both times has to be the same to the byte; one that does not (a search
that ended with its time) has to be whole and to tell of one of the two recordings.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lab_world import recording as on_a_table

import handcal
from handcal.recordings.export import write_mcap
from handcal.types import HandcalError
from handcal_sim import simulate, write

HANDCAL = (sys.executable, "-m", "handcal")
LONGEST_S = 300.0
# {k}: first or second run. All write into the folder they are run in, read from the one above.
COMMANDS = {
    "calibrate": "calibrate ../{k}.mcap --effects gyro_scale --json c.json --report c.html "
    "--rrd c.rrd",
    "explain": "explain ../{k}.mcap --budget 1 --json e.json --report e.html --twin t.mcap",
    "simulate": "simulate three-turns --seed {k} --duration 15 -o s.mcap",
    "sweep": "sweep --grid ../{k}.toml --seeds 2 --jobs 1 --json w.json --csv w.csv "
    "--report w.html",
    "sweep, one grid": "sweep --grid ../1.toml --seeds 2 --jobs 1 --out cells.jsonl --json v.json",
    "conceal": "conceal ../{k}.mcap --effect gyro_scale=0.0{k},0,0 -o x.mcap",
    "apply": "apply ../{k}.mcap --from ../r.json -o y.mcap",
    "fleet": "fleet ../fleet{k} --out fleet --budget 0 --workers 1",
    "lab": "lab known-input ../lab{k}.mcap --json l.json --report l.html",
}
# What says by itself whether it is whole, by ending: how it begins, how it ends.
ENDS = {".html": (b"<!doctype html", b"</html>"), ".rrd": (b"RRF", b""),
        ".parquet": (b"PAR1", b"PAR1")}  # fmt: skip


@dataclass(frozen=True)
class Alone:
    """What the runs write one by one: by name of the file the contents that are right; of files
    that differ from run to run, the sizes; how long a run took, s."""

    same: dict[str, set[bytes]]
    other: dict[str, list[int]]
    seconds: float


def prepare(folder: Path) -> None:
    """Recordings, grids and a result, for both runs."""
    for k in (1, 2):
        error = {"gyro_scale": [0.01 * k, -0.005, 0.0]}
        write(simulate("three-turns", seed=k, duration_s=15.0, effects=error),
              folder / f"{k}.mcap")  # fmt: skip
        (folder / f"fleet{k}").mkdir()
        (folder / f"fleet{k}/{k}.mcap").write_bytes((folder / f"{k}.mcap").read_bytes())
        write_mcap(on_a_table("steady-spins", seed=k), folder / f"lab{k}.mcap")
        (folder / f"{k}.toml").write_text(
            f"[common]\nduration_s = 20.0\n[grid]\nheading_sigma_deg = [{k}.0]\nr_h_rad = [0.1]\n"
        )
    words = ["calibrate", "1.mcap", "--effects", "gyro_scale", "--json", "r.json"]
    subprocess.run([*HANDCAL, *words], cwd=folder, check=True, capture_output=True)


def started(command: str, k: int, folder: Path) -> subprocess.Popen[str]:
    """A run, its words in pipes."""
    words = command.format(k=k).split()
    return subprocess.Popen([*HANDCAL, *words], cwd=folder, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True)  # fmt: skip


def ended(child: subprocess.Popen[str]) -> str:
    """What is wrong with how a run ended, nothing where it is done."""
    try:
        _, said = child.communicate(timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.communicate()
        return f"over {LONGEST_S:.0f} s"
    if child.returncode or "Traceback" in said:
        return f"status {child.returncode}: {said.strip()[-300:]}"
    return ""


def written(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {p.relative_to(folder).as_posix(): p.read_bytes()
            for p in sorted(folder.rglob("*")) if p.is_file()}  # fmt: skip


def alone(command: str, above: Path) -> Alone:
    """Both runs, one after the other, twice each. Raises RuntimeError where one fails."""
    runs: dict[int, list[dict[str, bytes]]] = {1: [], 2: []}
    began = time.monotonic()
    for k, found in runs.items():
        for _ in range(2):
            with tempfile.TemporaryDirectory(dir=above) as name:
                wrong = ended(started(command, k, Path(name)))
                if wrong:
                    raise RuntimeError(f"{command.format(k=k)}: {wrong}")
                found.append(written(Path(name)))
    seconds = (time.monotonic() - began) / 4.0
    names = {n for found in runs.values() for one in found for n in one}
    same = {n for n in names if all(one[0].get(n) == one[1].get(n) for one in runs.values())}
    return Alone(
        {n: {found[0][n] for found in runs.values() if n in found[0]} for n in same},
        {n: [len(one[n]) for found in runs.values() for one in found if n in one]
         for n in names - same}, seconds,
    )  # fmt: skip


def faults(folder: Path, right: Alone) -> list[str]:
    """What is wrong with the files of a folder into which two runs wrote."""
    there = written(folder)
    wrong = [f"{n}: no run wrote it" for n in there if n not in right.same | right.other]
    for name, whole in right.same.items():
        if name not in there:
            # (of two fleets, each has the results of its own recordings)
            wrong += [] if "/" in name else [f"{name}: not there"]
        elif name.endswith(".jsonl"):  # (both append: every line is of one of them)
            lines = {line for one in whole for line in one.splitlines(keepends=True)}
            if not set(there[name].splitlines(keepends=True)) <= lines:
                wrong.append(f"{name}: a line of neither of the two")
        elif there[name] not in whole:
            wrong.append(f"{name}: neither of the two, {len(there[name])} bytes")
    for name in right.other:
        if name in there and (fault := _broken(folder / name, there[name])):
            wrong.append(f"{name}: {fault}")
        elif name not in there and "/" not in name:
            wrong.append(f"{name}: not there")
    return wrong


def _broken(path: Path, content: bytes) -> str:
    """Of a file whose content differs from run to run: whether it is whole, of one run."""
    if path.suffix == ".json":
        try:
            json.loads(content)
        except ValueError as error:
            return f"no JSON: {error}"
    if path.suffix == ".jsonl":
        try:
            for line in content.splitlines():
                json.loads(line)
        except ValueError as error:
            return f"no JSON in a line: {error}"
    if path.suffix == ".mcap":
        try:
            cut = [w for w in handcal.load(path).warnings if "cut" in w or "damaged" in w]
        except HandcalError as error:
            return str(error)
        if cut:
            return cut[0]
    begin, end = ENDS.get(path.suffix, (b"", b""))
    if not (content.lower().startswith(begin) or content.startswith(begin)):
        return "does not begin as it should"
    if not content.rstrip().endswith(end):
        return "does not end as it should"
    if path.suffix in (".html", ".json") and b"1.mcap" in content and b"2.mcap" in content:
        return "tells of both runs" if "fleet" not in path.parts else ""
    return ""


def pair(command: str, above: Path, right: Alone, rng: np.random.Generator) -> list[str]:
    """Two runs at once; what is wrong with it."""
    with tempfile.TemporaryDirectory(dir=above) as name:
        first = started(command, 1, Path(name))
        time.sleep(float(rng.uniform(0.0, 0.6)) * right.seconds)
        second = started(command, 2, Path(name))
        wrong = [said for child in (first, second) if (said := ended(child))]
        return wrong + faults(Path(name), right)


def pairs(n: int, seed: int, only: str = "") -> dict[str, list[list[str]]]:
    """n pairs, the commands in turn; by command, of each pair what was wrong."""
    rng = np.random.default_rng(seed)
    chosen = {k: c for k, c in COMMANDS.items() if only in k}
    out: dict[str, list[list[str]]] = {k: [] for k in chosen}
    with tempfile.TemporaryDirectory() as name:
        above = Path(name)
        prepare(above)
        known = {k: alone(command, above) for k, command in list(chosen.items())[:n]}
        for i in range(n):
            kind = list(chosen)[i % len(chosen)]
            out[kind].append(pair(chosen[kind], above, known[kind], rng))
    return out


def main() -> int:
    """The command. Exit status 1 where anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=100, help="pairs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="commands whose name has this")
    options = parser.parse_args()
    found = pairs(options.n, options.seed, options.only)
    print("| command | pairs | wrong |\n|---|---|---|")
    for kind, wrong in found.items():
        print(f"| {kind} | {len(wrong)} | {sum(map(bool, wrong))} |")
    for kind, wrong in found.items():
        for fault in (f for one in wrong for f in one):
            print(f"{kind}: {fault}", file=sys.stderr)
    return 1 if any(any(w) for w in found.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
