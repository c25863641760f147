"""Answers against explanations: what was right, how often, and how honest the figures were.

Everything here is a function of `Trial`s and makes plain dictionaries, ready for JSON.

Outcomes of one recording: exact (verdict and names right), right_set (each truth in the set
named for it, or a doubt where there was none), too_faint (what was not named promised less
than LIMIT nats), missed (something was not named, nothing wrongly), false (more than the
truth was named), wrong (one thing was named for another), unexplained (known physics was
declared unknown), failed (no explanation).
"""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from handcal_sim.prove import (
    score_budget,
    score_odometry,
    score_ordinary,
    score_people,
    score_phone,
    score_strange,
)
from handcal_sim.prove.suites import SUITES, Answer
from handcal_sim.prove.terms import formula_fits
from handcal_sim.prove.trial import Trial, covered, matched, met, named, off, share

OUTCOMES = ("exact", "right_set", "too_faint", "missed", "false", "wrong", "unexplained", "failed")
LIMIT = 5.0
_EDGES = (0.0, 0.5, 0.8, 0.95, 0.99, 0.999)
_NAMING = ("explained", "cannot_tell")
# What a suite asks for beyond names.
_FURTHER: Mapping[str, Callable[[Sequence[Trial]], dict[str, Any]]] = {
    "phone": score_phone.score,
    "odometry": score_odometry.score,
    "people": score_people.score,
    "budget": score_budget.score,
    "strange": score_strange.score,
    "latest": score_strange.score,
    "ordinary": score_ordinary.score,
}
# Suites whose outcomes go by other rules.
_JUDGED: Mapping[str, Callable[[Trial], str]] = {
    "people": score_people.outcome,
    "strange": score_strange.outcome,
    "latest": score_strange.outcome,
    "ordinary": score_ordinary.outcome,
}


def outcome(trial: Trial) -> str:
    """One of OUTCOMES."""
    document, answer = trial.document, trial.answer
    if "error" in document:
        return "failed"
    if answer.suite in _JUDGED:
        return _JUDGED[answer.suite](trial)
    verdict = document["verdict"]
    if answer.stranger:
        return {"unexplained": "exact", "nothing_missing": "missed"}.get(verdict, "wrong")
    if not answer.effects:
        return "exact" if verdict == "nothing_missing" else "false"
    if verdict == "unexplained":
        return "unexplained"
    sets = named(document) if verdict in _NAMING else []
    pairs = matched(answer.effects, sets)
    unseen, extra = set(answer.effects) - set(pairs), len(sets) - len(pairs)
    if unseen:
        faint = all(trial.expected.get(name, math.inf) < LIMIT for name in unseen)
        return "wrong" if extra else "too_faint" if faint else "missed"
    if extra:
        return "false"
    led = all(sets[k][0] == name for name, k in pairs.items())
    return "exact" if led and verdict == "explained" else "right_set"


def score(trials: Sequence[Trial], seed: int) -> dict[str, Any]:
    """The whole result of a trial."""
    return {
        "schema": "handcal-sim/proof/1",
        "seed": seed,
        "suites": suites(trials),
        "effects": confusion(trials),
        "unknown": unknown(trials),
        "coverage": {"effects": coverage(trials), "baseline": baseline_coverage(trials)},
        "probabilities": probabilities(trials),
        "held_out": held_out(trials),
        "further": further(trials),
        "seconds": seconds(trials),
        "recordings": [_line(trial) for trial in trials],
    }


def further(trials: Sequence[Trial]) -> dict[str, dict[str, Any]]:
    """By suite: what it asks for beyond names."""
    members = {name: [t for t in trials if t.answer.suite == name] for name in _FURTHER}
    return {name: _FURTHER[name](those) for name, those in members.items() if those}


def _line(trial: Trial) -> dict[str, Any]:
    document, answer = trial.document, trial.answer
    return {
        "recording": trial.name,
        "suite": answer.suite,
        "group": answer.group,
        "outcome": outcome(trial),
        "truth": _truth(answer),
        "verdict": document.get("verdict", "failed"),
        "named": [] if "error" in document else named(document),
        "unnamed": [u["formula"] for u in document.get("unnamed", [])],
        "expected": dict(trial.expected),
        "further": dict(trial.further),
        "seconds": trial.seconds,
        **({"error": document["error"]} if "error" in document else {}),
    }


def suites(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """Each suite, and each group within, against its target; what is too faint is not judged."""
    by: dict[tuple[str, str], list[Trial]] = defaultdict(list)
    for trial in trials:
        by[trial.answer.suite, trial.answer.group].append(trial)
    rows = []
    order = list(SUITES)
    for name, group in sorted(by, key=lambda key: (order.index(key[0]), key[1])):
        members, suite = by[name, group], SUITES[name]
        counts = Counter(outcome(trial) for trial in members)
        right = sum(counts[kind] for kind in suite.right)
        judged = share(right, len(members) - counts["too_faint"])
        target = suite.target if not group else None
        sets = [s for t in members if outcome(t) == "right_set" for s in named(t.document)]
        rows.append({
            "suite": name, "group": group, "title": suite.title, "n": len(members),
            "outcomes": {kind: counts[kind] for kind in OUTCOMES},
            "right": judged, "target": target,
            "met": None if target is None else met(judged, target),
            "mean_set_size": float(np.mean([len(s) for s in sets])) if sets else None,
        })  # fmt: skip
    return rows


def confusion(trials: Sequence[Trial]) -> dict[str, dict[str, Any]]:
    """By truth: how often it was there, named first, in the set, and what else was named.

    "nothing" stands for what is not there and, as a name, for what was not named.
    """
    rows: dict[str, dict[str, Any]] = defaultdict(
        lambda: {"n": 0, "named": 0, "in_set": 0, "instead": Counter()}
    )
    for trial in trials:
        if outcome(trial) == "failed":
            continue
        truth = _truth(trial.answer)
        sets = named(trial.document)
        pairs = matched(trial.answer.effects, sets)
        spare = [s[0] for k, s in enumerate(sets) if k not in pairs.values()]
        if trial.document["verdict"] == "unexplained":
            spare.append("unexplained")
        for name in truth:
            rows[name]["n"] += 1
            if name in pairs:
                rows[name]["named" if sets[pairs[name]][0] == name else "in_set"] += 1
            elif spare or name != "nothing":
                rows[name]["instead"].update(spare or ["nothing"])
        if spare and len(pairs) == len(trial.answer.effects) > 0:
            rows["nothing"]["instead"].update(spare)
    return {name: {**row, "instead": dict(row["instead"])} for name, row in sorted(rows.items())}


def _kind(answer: Answer) -> str:
    return f"unknown: {answer.stranger['kind']}" if answer.stranger else "nothing"


def _truth(answer: Answer) -> list[str]:
    """What was there: known effects, and a stranger or nothing."""
    return [*answer.effects, *([] if answer.effects and not answer.stranger else [_kind(answer)])]


def unknown(trials: Sequence[Trial]) -> dict[str, dict[str, int]]:
    """By kind of unknown physics: how many, declared unknown, and with a fitting formula. What a
    suite of its own asks for more of is not repeated."""
    rows: dict[str, dict[str, int]] = {}
    for trial in trials:
        if not trial.answer.stranger or trial.answer.suite in _FURTHER:
            continue
        zero = {"n": 0, "unexplained": 0, "channel": 0, "formula": 0}
        row = rows.setdefault(trial.answer.stranger["kind"], zero)
        row["n"] += 1
        row["unexplained"] += trial.document.get("verdict") == "unexplained"
        fits = [formula_fits(u["formula"], trial.answer.stranger)
                for u in trial.document.get("unnamed", [])]  # fmt: skip
        row["channel"] += any(channel for channel, _ in fits)
        row["formula"] += any(signals for _, signals in fits)
    return dict(sorted(rows.items()))


def coverage(trials: Sequence[Trial]) -> dict[str, dict[str, Any]]:
    """By rightly named effect and over all: share of parameters within 1 and 3 of their sigmas."""
    sigmas: dict[str, list[float]] = {"all": []}
    for trial in trials:
        if trial.answer.stranger or trial.document.get("verdict") not in _NAMING:
            continue
        for missing in trial.document["missing"]:
            truth = trial.answer.truth(missing["effect"])
            if truth is not None:
                found = off(missing["parameters"], truth)
                sigmas["all"] += found
                sigmas.setdefault(missing["effect"], []).extend(found)
    return {name: covered(values) for name, values in sigmas.items()}


def baseline_coverage(trials: Sequence[Trial]) -> dict[str, Any]:
    """The same for the biases where verdict and names are exact."""
    sigmas: list[float] = []
    for trial in trials:
        if outcome(trial) == "exact" and not trial.answer.stranger:
            for name, truth in trial.answer.baseline.items():
                of = [p for p in trial.document.get("parameters", []) if p["effect"] == name]
                sigmas += off(of, truth)
    return covered(sigmas)


def probabilities(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """What was claimed to be present with which probability, and how often it was."""
    return reliability([claim for trial in trials for claim in claims(trial)])


def claims(trial: Trial) -> list[tuple[float, bool]]:
    """Of each name the probability, and whether what it stands for is there."""
    if "error" in trial.document:
        return []
    right = set(matched(trial.answer.effects, named(trial.document)).values())
    found = enumerate(trial.document["missing"])
    return [(float(missing["probability"]), k in right) for k, missing in found]


def reliability(claims: Sequence[tuple[float, bool]]) -> list[dict[str, Any]]:
    """Claims by their probability: how many came true of each range."""
    rows = []
    for low, high in itertools.pairwise((*_EDGES, math.inf)):
        inside = [(p, true) for p, true in claims if low <= p < high]
        mean = float(np.mean([p for p, _ in inside])) if inside else None
        right_share = share(sum(true for _, true in inside), len(inside))
        rows.append({"from": low, "to": min(high, 1.0), "claimed": mean, **right_share})
    return rows


def held_out(trials: Sequence[Trial]) -> dict[str, Any]:
    """Where something was explained: did data that the fit had not seen gain by it?"""
    gains = [
        h["log_score_after"] - h["log_score_before"]
        for t in trials
        if t.document.get("verdict") in ("explained", "cannot_tell", "unexplained")
        and (h := t.document.get("held_out"))
    ]
    median = float(np.median(gains)) if gains else None
    return {"gained": share(sum(g > 0.0 for g in gains), len(gains)), "median": median}


def seconds(trials: Sequence[Trial]) -> dict[str, float | None]:
    """Time of one explanation."""
    taken = [trial.seconds for trial in trials]
    if not taken:
        return {"median": None, "p90": None, "most": None}
    return {"median": float(np.median(taken)), "p90": float(np.quantile(taken, 0.9)),
            "most": max(taken)}  # fmt: skip
