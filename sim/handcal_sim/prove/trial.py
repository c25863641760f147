"""One recording of a blind trial, and how shares, names and deviations of many are counted."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from handcal_sim.effects import EFFECTS
from handcal_sim.prove.suites import Answer

Document = Mapping[str, Any]
Named = list[list[str]]


@dataclass(frozen=True)
class Trial:
    """One recording: its answer, the explanation (or {"error": ...}), and how long that took.

    expected: nats that an injected effect promises there, as far as they were asked for.
    further: what was worked out besides from what only the simulator knows, such as readings
    that the explanation has not seen.
    """

    name: str
    answer: Answer
    document: Document
    seconds: float
    expected: Mapping[str, float] = field(default_factory=dict)
    further: Mapping[str, float] = field(default_factory=dict)


def wilson(successes: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a share (E. B. Wilson 1927); all there is without a single trial."""
    if n == 0:
        return 0.0, 1.0
    share, spread = successes / n, z * z / n
    middle = share + 0.5 * spread
    half = z * math.sqrt((share * (1.0 - share) + 0.25 * spread) / n)
    return max(0.0, (middle - half) / (1.0 + spread)), min(1.0, (middle + half) / (1.0 + spread))


def share(successes: int, n: int) -> dict[str, Any]:
    """A count as a share with its interval."""
    low, high = wilson(successes, n)
    return {"n": n, "count": successes, "share": successes / n if n else None,
            "interval": [low, high]}  # fmt: skip


def met(measured: Mapping[str, Any], target: float, at_most: bool = False) -> bool | None:
    """Whether a share is as large as is asked (at_most: as small); None where the trials are so few
    that one which is barely good enough would be expected to show no single failure."""
    if not measured["n"]:
        return None
    if at_most:
        good, spared = measured["share"] <= target, target
    else:
        good, spared = measured["share"] >= target, 1.0 - target
    # (rounding: a twentieth of twenty is one)
    return (True if spared * measured["n"] > 1.0 - 1e-9 else None) if good else False


def named(document: Document) -> Named:
    """What was named: for each missing effect its name and then the others of its set."""
    return [[m["effect"], *m.get("indistinguishable_from", [])] for m in document["missing"]]


def matched(truth: Iterable[str], sets: Named) -> dict[str, int]:
    """Which set stands for which truth: as many as possible, leading names before others."""
    from scipy.optimize import linear_sum_assignment

    true = sorted(truth)
    worth = np.array([[(len(true) + 1.0) * (t in s) + (s[0] == t) for s in sets] for t in true])
    if worth.size == 0:
        return {}
    rows, columns = linear_sum_assignment(worth, maximize=True)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return {true[i]: k for i, k in pairs if worth[i, k] > 0.0}


def off(parameters: Iterable[Mapping[str, Any]], truth: Mapping[str, float]) -> list[float]:
    """By how many of their sigmas parameters differ from the truth."""
    return [
        (p["value"] - truth[p["name"]]) / p["sigma"]
        for p in parameters
        if p["name"] in truth and (p["sigma"] or 0.0) > 0.0
    ]


def covered(off: Sequence[float]) -> dict[str, Any]:
    """Shares of deviations within 1 and 3 sigmas, and their root mean square."""
    size = np.abs(np.asarray(off, dtype=float))
    rms = float(np.sqrt(np.mean(size**2))) if len(size) else None
    return {"within_1_sigma": share(int(np.sum(size < 1.0)), len(size)),
            "within_3_sigma": share(int(np.sum(size < 3.0)), len(size)), "rms": rms}  # fmt: skip


def reported(trial: Trial, effects: Collection[str]) -> dict[str, list[float]]:
    """By effect: how many sigmas the final model's parameters are from the truth.

    What was not injected is truly zero. What the explanation calls untellable does not count.
    """
    untold = {(u["effect"], u["name"]) for u in trial.document.get("untellable", [])}
    found: dict[str, list[float]] = {}
    for p in trial.document.get("parameters", []):
        name = p["effect"]
        if name not in effects or (name, p["name"]) in untold:
            continue
        truth = trial.answer.truth(name) or trial.answer.baseline.get(name)
        zero = {parameter.name: 0.0 for parameter in EFFECTS[name]}
        found.setdefault(name, []).extend(off([p], truth or zero))
    return found


def together(trials: Iterable[Trial], effects: Collection[str]) -> dict[str, dict[str, Any]]:
    """The same of many: coverage over "all", and by effect."""
    every: dict[str, list[float]] = {"all": []}
    for trial in trials:
        for name, values in reported(trial, effects).items():
            every["all"] += values
            every.setdefault(name, []).extend(values)
    return {name: covered(values) for name, values in every.items()}
