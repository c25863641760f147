"""Effects concealed in real hands' recordings: what was put in, and what explain makes of it.

    python benchmarks/conceal_table.py RECORDING... [--n N] [--seed S] [--out DIR]

Every effect that a recording could show is added to it by ``handcal conceal``, each parameter
between half and one and a half times its prior, and ``handcal explain`` is run on the new file
in a process of its own. What it says is compared with the same of the unaltered file: an effect
counts as named if it is in ``missing`` or in one of its sets, and a parameter as right if it
differs from the unaltered recording's by what was put in, within three sigma. Densities of
noise add up in squares. What ``explain`` found in the unaltered file is known to ``conceal``:
the device's own errors are no motion.

A full table takes hours; ``--n`` draws that many pairs of recording and effect at random.
Results are kept in DIR, and a table that broke off goes on from there.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from handcal.effects import Effect, catalogue
from handcal.recordings.inputs import load

# Nats below which the recording itself does not promise that an effect of the usual size shows.
FAINT = 10.0
# What differs at high frequency alone (the contract's gauges).
PARTNER = {"accel_delay": "gyro_bandwidth", "gyro_bandwidth": "accel_delay"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--n", type=int, help="pairs to draw (all)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("conceal-out"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(options.seed)
    pairs = list(itertools.product(options.recordings, catalogue().values()))
    if options.n is not None:
        pairs = [pairs[i] for i in rng.permutation(len(pairs))]
    done: list[dict[str, Any]] = []
    progress = track(pairs, "Concealed and explained", console=Console(stderr=True))
    for path, effect in progress:
        values = _values(effect, load(path).duration_s, rng)
        entry = _tried(path, effect, values, options.out)
        if entry is not None:
            done.append(entry)
        if options.n is not None and sum(d["outcome"] != "refused" for d in done) >= options.n:
            break
    (options.out / "table.json").write_text(json.dumps(done, indent=1))
    _shown(done)


def _values(effect: Effect, duration: float, rng: np.random.Generator) -> list[float]:
    """A size for each parameter, drawn whether or not the effect can be added."""
    out = []
    for p in effect.parameters:
        size = p.prior_sigma * rng.uniform(0.5, 1.5)
        sign = 1.0 if p.positive else rng.choice([-1.0, 1.0])
        # (a moment is no size)
        out.append(duration * rng.uniform(0.3, 0.7) if p.name == "at" else float(sign * size))
    return out


def _tried(path: Path, effect: Effect, values: list[float], out: Path) -> dict[str, Any] | None:
    name = f"{path.stem}-{effect.id}"
    entry: dict[str, Any] = {"recording": path.stem, "effect": effect.id, "injected": values}
    altered = out / f"{name}.mcap"
    text = ",".join(f"{v:.6g}" for v in values)
    own = _explained(path, out / f"{path.stem}.json")
    known = ("--from", out / f"{path.stem}.json") if own is not None else ()
    concealed = _run(
        "conceal", path, f"--effect={effect.id}={text}", "--seed=0", *known, "-o", altered
    )
    if concealed.returncode != 0:
        return entry | {"outcome": "refused", "reason": concealed.stderr.strip().splitlines()[-1]}
    seen = _explained(altered, out / f"{name}.json")
    altered.unlink()
    if seen is None or own is None:
        return entry | {"outcome": "failed"}
    return entry | _compared(effect, values, own, seen)


def _run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "handcal", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _explained(path: Path, document: Path) -> dict[str, Any] | None:
    if not document.exists() and _run("explain", path, "--json", document).returncode != 0:
        return None
    answer: dict[str, Any] = json.loads(document.read_text())
    return answer


def _compared(
    effect: Effect, values: list[float], own: dict[str, Any], seen: dict[str, Any]
) -> dict[str, Any]:
    named = [m["effect"] for m in seen["missing"]]
    sets = [i for m in seen["missing"] for i in m["indistinguishable_from"]]
    before, after = ({(p["effect"], p["name"]): p for p in _all_parameters(d)} for d in (own, seen))
    promised = {
        h["effect"]: h["expected_gain"] for h in own["hypotheses"] if h["expected_gain"] is not None
    }
    new = sorted(set(named) - {m["effect"] for m in own["missing"]} - {effect.id})
    gone = sorted({m["effect"] for m in own["missing"]} - set(named) - {effect.id})
    outcome = "missed"
    if effect.id in named:
        outcome = "named"
    elif effect.id in sets:
        outcome = "in a set"
    elif effect.process is None and promised.get(effect.id, math.inf) < FAINT:
        outcome = "too faint"
    z, recovered = [], []
    for p, value in zip(effect.parameters, values, strict=True):
        if (effect.id, p.name) not in after:
            continue
        shared = PARTNER.get(effect.id) in {*new, *gone}
        (a, spread), (b, spread_before) = (
            _place(x, effect.id, p.name, shared) for x in (after, before)
        )
        if effect.process is not None and p.name in ("density", "sigma"):
            total = math.hypot(b, value)
            recovered.append(math.sqrt(max(a * a - b * b, 0.0)))
            z.append((a - total) / math.hypot(spread, spread_before * b / total))
            continue
        change, sigma = a - b, math.hypot(spread, spread_before)
        recovered.append(change)
        z.append((change - value) / sigma if sigma > 0.0 else math.nan)
    return {
        "outcome": outcome, "verdict": seen["verdict"], "recovered": recovered, "z": z,
        "new": new, "gone": gone, "unnamed": [u["formula"] for u in seen["unnamed"]],
        "promised": promised.get(effect.id),
    }  # fmt: skip


def _place(
    found: dict[tuple[str, str], dict[str, Any]], effect: str, name: str, shared: bool
) -> tuple[float, float]:
    """Value and sigma. Of an accelerometer's place, with the arm that all of them share: alone,
    ``size_effect`` holds the device's own lever arm too. Where the other of a late force and a
    slow gyro is named before or after alone (``shared``), what both make of the force's lag."""
    here = [(1.0, found.get((effect, name)))]
    if effect == "size_effect":
        here.append((1.0, found.get(("lever_arm", name[-1]))))
    if shared and effect in PARTNER:
        other = PARTNER[effect]
        here.append((-1.0, found.get((other, "tau" if other == "gyro_bandwidth" else "delay"))))
    present = [(sign, p) for sign, p in here if p]
    return sum(s * p["value"] for s, p in present), math.hypot(*(p["sigma"] for _, p in present))


def _all_parameters(document: dict[str, Any]) -> list[dict[str, Any]]:
    named = [{"effect": m["effect"], **p} for m in document["missing"] for p in m["parameters"]]
    return named + document["parameters"]


def _shown(done: list[dict[str, Any]]) -> None:
    console = Console(width=160)
    table = Table(
        "recording", "effect", "outcome", "verdict", "injected", "recovered", "z", "beside"
    )
    for d in done:
        if d["outcome"] == "refused":
            continue
        beside = [*(f"+{i}" for i in d["new"]), *(f"-{i}" for i in d["gone"])]
        table.add_row(
            d["recording"], d["effect"], d["outcome"], d["verdict"],
            *(" ".join(f"{x:.3g}" for x in d[k]) for k in ("injected", "recovered")),
            " ".join(f"{x:.1f}" for x in d["z"]), ", ".join(beside),
        )  # fmt: skip
    console.print(table)
    told = [d for d in done if d["outcome"] in ("named", "in a set", "missed", "failed")]
    right = [d for d in told if d["outcome"] in ("named", "in a set")]
    z = np.array([x for d in right for x in d["z"] if math.isfinite(x)])
    faint = sum(d["outcome"] == "too faint" for d in done)
    refused = [d for d in done if d["outcome"] == "refused"]
    if told:
        console.print(
            f"{len(right)} of {len(told)} named ({len(right) / len(told):.0%}; asked 85 %); "
            f"{faint} too faint for this recording, {len(refused)} not to be added to it."
        )
    if len(z):
        console.print(
            f"{len(z)} parameters: {100 * np.mean(np.abs(z) < 3):.0f} % within three sigma "
            f"(asked 95 %), rms of z {np.sqrt(np.mean(z**2)):.2f}, median of |z| "
            f"{np.median(np.abs(z)):.2f}."
        )
    for reason in sorted({d["reason"] for d in refused}):
        console.print(f"  not added: {reason}", highlight=False)


if __name__ == "__main__":
    main()
