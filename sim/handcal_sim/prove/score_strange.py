"""The suite `strange`: is a law outside the catalogue told, and not called by another's name?

Outcomes: exact (unexplained, on the right channels, by the right drivers), right_set (the same but
for the drivers), false (either, with a catalogue name that is not there), wrong (unexplained
elsewhere, or names for it), missed (called clean: nothing is said that is not so, but the law is
passed over).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from handcal_sim.prove.trial import Trial, matched, named, share
from handcal_sim.strange.words import same

# A formula is as good as the law where it leaves a hundredth of it; a curve, a tenth.
SAME, LITTLE = 0.01, 0.1
# Nats, odds of twenty to one, by which a truth must be likelier for the search to have missed it.
SURE = 3.0
Document = Mapping[str, Any]


def false_names(trial: Trial) -> list[str]:
    """Names, each the first of its set, that stand for no effect that was there."""
    sets = named(trial.document)
    right = matched(trial.answer.effects, sets).values()
    return [names[0] for k, names in enumerate(sets) if k not in right]


def channels_told(law: Mapping[str, Any], document: Document) -> bool:
    """Whether the document is unexplained, and something without a name is on each channel."""
    where = {channel for entry in document["unnamed"] for channel in entry["channels"]}
    return document["verdict"] == "unexplained" and set(law["channels"]) <= where


def drivers_told(law: Mapping[str, Any], document: Document) -> bool:
    """Whether, besides, on each channel something is driven by what drives the law."""
    return channels_told(law, document) and all(
        any(channel in entry["channels"] and same(entry["drivers"], drivers, channel)
            for entry in document["unnamed"])
        for channel, drivers in zip(law["channels"], law["drivers"], strict=True)
    )  # fmt: skip


def outcome(trial: Trial) -> str:
    """One of those above, or failed."""
    document, laws = trial.document, trial.answer.stranger["laws"]
    if "error" in document:
        return "failed"
    false = bool(false_names(trial))
    if all(channels_told(law, document) for law in laws):
        driven = all(drivers_told(law, document) for law in laws)
        return "false" if false else "exact" if driven else "right_set"
    return "wrong" if false or document["verdict"] == "unexplained" else "missed"


def score(trials: Sequence[Trial]) -> dict[str, Any]:
    """Each law, and over recordings: told, driver besides, called clean, with false names; over
    laws: how many are left by a tenth at most, and by a hundredth, and by that where `calibrate`
    is told the law and has but its size to find, or its size and its numbers. A failure is none of
    these. Of recordings whose drivers are not told: in how many the truth is likelier than the
    explanation (where it is not, no search over probabilities could tell it)."""
    laws = [row for trial in trials for row in _rows(trial)]
    left = [row["left"] for row in laws]
    limits = {kind: [row[kind] if row[kind] is not None else row["left"]
                     for row in laws if row[kind] is not None or _reached(row)]
              for kind in ("told", "form")}  # fmt: skip
    by = [outcome(trial) for trial in trials]
    told = [_all(channels_told, trial) for trial in trials]
    driven = [_all(drivers_told, trial) for trial in trials]
    truths = [_truth(trial) for trial, right in zip(trials, driven, strict=True) if not right]
    missed = [x for x in truths if x is not None]
    return {
        "laws": laws,
        "told": share(sum(told), len(trials)),
        "driver": share(sum(driven), len(trials)),
        "clean": share(by.count("missed"), len(trials)),
        "false": share(sum(bool(_false(trial)) for trial in trials), len(trials)),
        "little_left": share(sum(x is not None and x <= LITTLE for x in left), len(left)),
        "nothing_left": share(sum(x is not None and x <= SAME for x in left), len(left)),
        **{f"nothing_left_if_{kind}": share(sum(x <= SAME for x in some), len(some))
           for kind, some in limits.items()},
        "truth_is_likelier": share(sum(x > SURE for x in missed), len(missed)),
    }  # fmt: skip


def _truth(trial: Trial) -> float | None:
    """Nats by which the laws themselves and the true names make a recording more probable than the
    explanation did; None where that was not asked, or cannot be compared."""
    told = trial.further.get("told_log_evidence")
    if told is None or trial.document["hand"]["id"] != "held":
        return None
    return told - float(trial.document["fit"]["after"]["log_evidence"])


def _reached(row: Mapping[str, Any]) -> bool:
    return row["channels"] != ["heading"] and (row["left"] or 1.0) <= SAME


def _all(told: Any, trial: Trial) -> bool:
    document = trial.document
    return "error" not in document and all(
        told(law, document) for law in trial.answer.stranger["laws"]
    )


def _false(trial: Trial) -> list[str]:
    return [] if "error" in trial.document else false_names(trial)


def _rows(trial: Trial) -> list[dict[str, Any]]:
    """By law of a recording: what was there, and what was said of it."""
    document, rows = trial.document, []
    failed = "error" in document
    for n, law in enumerate(trial.answer.stranger["laws"], start=1):
        rows.append({
            "recording": trial.name, "law": law["law"], "channels": law["channels"],
            "drivers": law["drivers"], "formula": law["formula"], "k": law["k"],
            "verdict": "failed" if failed else document["verdict"],
            "channel": not failed and channels_told(law, document),
            "driver": not failed and drivers_told(law, document),
            "false": _false(trial),
            "found": [] if failed else [entry["formula"] for entry in document["unnamed"]],
            "left": trial.further.get(f"left_{n}"), "told": trial.further.get(f"told_{n}"),
            "form": trial.further.get(f"form_{n}"),
            "truth": _truth(trial),
        })  # fmt: skip
    return rows
