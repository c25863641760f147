"""The suite `people`: is anything the matter with sensors in whose hands people do things?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from handcal_sim.prove.trial import Trial

_OF_NORTH = ("heading_", "mag_")


def wrongly_named(trial: Trial) -> list[str]:
    """What is named but was not there; iron that passes may be called an error of heading."""
    iron = trial.answer.circumstances["iron"]
    names = [str(missing["effect"]) for missing in trial.document.get("missing", [])]
    return [name for name in names if not (iron and name.startswith(_OF_NORTH))]


def outcome(trial: Trial) -> str:
    """exact or false."""
    return "false" if wrongly_named(trial) else "exact"


def score(trials: Sequence[Trial]) -> dict[str, Any]:
    """By what was done: how often, and what was wrongly named for it; verdicts over all."""
    rows: dict[str, Any] = {}
    for trial in trials:
        for doing in trial.answer.circumstances["doings"]:
            row = rows.setdefault(doing, {"n": 0, "false": 0, "named": Counter()})
            wrong = wrongly_named(trial)
            row["n"] += 1
            row["false"] += bool(wrong)
            row["named"].update(wrong)
    verdicts = Counter(str(t.document.get("verdict", "failed")) for t in trials)
    plain: Mapping[str, Any] = {k: {**row, "named": dict(row["named"])} for k, row in rows.items()}
    return {"doings": plain, "verdicts": dict(verdicts)}
