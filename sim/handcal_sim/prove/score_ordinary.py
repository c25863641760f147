"""The suite `ordinary`: are all numbers honest, is what is clear named, and nothing that few have
where it is not there?

Outcomes: false (a name of something rare that is not there, a law's included), missed (something
rare that is clear has neither name nor law), else exact. Which of the common errors are named is no
matter of right or wrong where they are faint: a device has them all.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

from handcal_sim.prove.ordinary_devices import SPREADS
from handcal_sim.prove.ordinary_numbers import DRAWN, asked, coverage, deviations, rare
from handcal_sim.prove.trial import Trial, met, named, share

# So many sigmas make an effect that every device has, and what few have, clear.
CLEAR, CLEARLY_RARE = 5.0, 10.0
# Least shares of both that are to be found, and the largest of devices with a false rare name.
FOUND, RARE_FOUND, FALSE = 0.95, 0.90, 0.03


def false_names(trial: Trial) -> list[str]:
    """Names of what few devices have, and laws, where there is no such thing."""
    there = {*SPREADS, trial.answer.circumstances["rare"]}
    names = [name for name, *_ in named(trial.document) if name not in there]
    laws = [] if rare(trial) else [str(u["formula"]) for u in trial.document.get("unnamed", [])]
    return names + laws


def rare_found(trial: Trial) -> bool:
    """Whether what the device has that few have is named, or told as a law."""
    name = trial.answer.circumstances["rare"]
    return bool(trial.document.get("unnamed")) or any(name in s for s in named(trial.document))


def rare_clear(trial: Trial) -> bool:
    """Whether it would be clear if all names were told."""
    return bool(rare(trial)) and trial.further.get("rare_sigmas", 0.0) > CLEARLY_RARE


def clear(trial: Trial) -> dict[str, bool]:
    """Each common effect whose truth is clear beside the sigmas that are told of it, and whether it
    is named."""
    square: dict[str, float] = {}
    for d in deviations([trial]):
        if d.what == DRAWN and d.effect in SPREADS:
            square[d.effect] = square.get(d.effect, 0.0) + (d.truth / d.sigma) ** 2
    sets = named(trial.document)
    return {
        effect: any(effect in names for names in sets)
        for effect, of in square.items()
        if math.sqrt(of) > CLEAR
    }


def outcome(trial: Trial) -> str:
    """exact, false or missed."""
    if false_names(trial):
        return "false"
    return "missed" if rare_clear(trial) and not rare_found(trial) else "exact"


def score(trials: Sequence[Trial]) -> dict[str, Any]:
    """Numbers and names beside what is asked of them. not_found, false_names: how often each."""
    told = [t for t in trials if "error" not in t.document]
    covered = coverage(deviations(told))
    found = [pair for trial in told for pair in clear(trial).items()]
    few = [rare_found(trial) for trial in told if rare_clear(trial)]
    wrong = [false_names(trial) for trial in told]
    shares = {
        "found": share(sum(there for _, there in found), len(found)),
        "rare_found": share(sum(few), len(few)),
        "false_rare": share(sum(map(bool, wrong)), len(wrong)),
    }
    limits = {"found": FOUND, "rare_found": RARE_FOUND, "false_rare": FALSE}
    return {
        "coverage": covered,
        "numbers_asked": asked(covered, drawing_priors=False),
        **shares,
        "names_asked": {
            name: {"asked": limit, "met": met(shares[name], limit, name == "false_rare")}
            for name, limit in limits.items()
        },
        "not_found": dict(Counter(effect for effect, there in found if not there)),
        "false_names": dict(Counter(name for names in wrong for name in names)),
    }
