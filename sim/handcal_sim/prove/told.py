"""What `calibrate` leaves if it is told all that is there, the names or the very law: what no
explanation has to beat."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from handcal_sim.prove import draw_budget, draw_ordinary, draw_strange
from handcal_sim.prove.given import Ticket
from handcal_sim.prove.score_budget import MEDIAN
from handcal_sim.prove.score_strange import SAME
from handcal_sim.prove.suites import Answer
from handcal_sim.strange.device import Added
from handcal_sim.strangers import column_of

if TYPE_CHECKING:
    from handcal.effects import Effect, Signals
    from handcal.types import Array


# Standard deviation of a number of which but its range is known, that being one.
RANGE = 12.0**-0.5
# Nats without end are a great many.
MOST = 1e6
# A moment, and which readings are wrong.
_UNTOLD = ("gyro_bias_step", "heading_outliers")


def told(
    ticket: Ticket, answer: Answer, file: Path, further: Mapping[str, float]
) -> dict[str, float]:
    """Shares left of what an explanation leaves more of than is asked: "told" of a gyro's error
    (suite budget), "told_1" and so on of laws (suite strange), and how probable these make the
    recording; how clear something rare is ("rare_sigmas", suite ordinary)."""
    work = _TOLD.get(ticket.suite)
    return {} if work is None else work(ticket, answer, file, further)


def _budget(
    ticket: Ticket, answer: Answer, file: Path, further: Mapping[str, float]
) -> dict[str, float]:
    if further.get("share_left", 0.0) <= MEDIAN:
        return {}
    found = _calibrated(file, list(answer.effects))
    return {"told": draw_budget.left(ticket, found)["share_left"]}


def _strange(
    ticket: Ticket, answer: Answer, file: Path, further: Mapping[str, float]
) -> dict[str, float]:
    """Each law as an effect with its true course and one unknown, its size ("told"), and with its
    numbers as further unknowns ("form"); not beside what `calibrate` cannot be told, nor of a
    heading, whose courses are no effects."""
    case = draw_strange.case_of(ticket)
    laws = case.laws
    reached = all(further.get(f"left_{n + 1}", 1.0) <= SAME for n in range(len(laws)))
    heading = any(one.strange.channel == "heading" for law in laws for one in law)
    if reached or heading or set(_UNTOLD) & set(answer.effects):
        return {}
    from handcal.effects import with_effects

    shares: dict[str, float] = {}
    probable: dict[str, float] = {}
    for kind, free in (("told", False), ("form", True)):
        columns = [[draw_strange.columns(one, case.world, free) for one in law] for law in laws]
        effects = [_course(f"law_{n}", case.world.t, law, columns[n]) for n, law in enumerate(laws)]
        with with_effects((effect.id, effect) for effect in effects):
            found = _calibrated(file, [*answer.effects, *(effect.id for effect in effects)])
        listed = found["parameters"]
        sizes = [[p["value"] for p in listed if p["effect"] == e.id] for e in effects]
        left = draw_strange.left_of_sizes(ticket, listed, sizes, free)
        shares |= {name.replace("left", kind): share for name, share in left.items()}
        probable[kind] = float(found["fit"]["log_evidence"])
    return {**shares, "told_log_evidence": probable["told"]}


def _ordinary(
    ticket: Ticket, answer: Answer, file: Path, _further: Mapping[str, float]
) -> dict[str, float]:
    """By how many sigmas what few devices have would show if all names were told
    ("rare_sigmas"). Of a heading's law: beside white noise alone."""
    from handcal.types import InputError

    given = answer.circumstances
    common = [n for n in answer.effects if n != given["rare"] and _told_of(n, given)]
    sigmas = None
    try:
        if given["rare"]:
            sigmas = _of_rare(answer.effects[given["rare"]], given["rare"], common, file)
        elif answer.stranger:
            (law,) = answer.stranger["laws"]
            if law["channels"] == ["heading"]:
                noise = math.radians(given["heading_sigma_deg"])
                seen = given["duration_s"] * given["heading_hz"]
                sigmas = law["left"][0] / noise * math.sqrt(seen)
            else:
                sigmas = _of_law(draw_ordinary.case_of(ticket), common, file)
    except InputError:  # (a pose that was left out has no delay to be told of)
        return {}
    return {} if sigmas is None else {"rare_sigmas": sigmas}


def _told_of(effect: str, given: Mapping[str, Any]) -> bool:
    return bool(given["thermometer"]) or not effect.endswith("_temperature")


def _of_law(case: draw_ordinary.Case, common: Sequence[str], file: Path) -> float | None:
    from handcal.effects import with_effects

    world = draw_ordinary.recorded(case)
    laws = draw_ordinary.acting(case.laws, world)
    effect = _course("law", world.t, laws, [one.error[:, None] for one in laws])
    with with_effects([(effect.id, effect)]):
        return _sigmas(_calibrated(file, [*common, effect.id], "auto"), effect.id, {"size": 1.0})


def _of_rare(
    truth: Mapping[str, float], name: str, common: Sequence[str], file: Path
) -> float | None:
    """(Of what `calibrate` cannot be told, or tells no sigma of, by the nats that it promises.)"""
    import handcal
    from handcal.explain.expected_gain import expected_gain

    sigmas = None
    if name not in _UNTOLD:
        sigmas = _sigmas(_calibrated(file, [*common, name], "auto"), name, truth)
    if sigmas is None:
        nats = expected_gain(handcal.load(file), name, list(truth.values()))
        sigmas = math.sqrt(min(max(2.0 * nats, 0.0), MOST))
    return sigmas


def _sigmas(document: Mapping[str, Any], effect: str, truth: Mapping[str, float]) -> float | None:
    """How many sigmas the truth is away from nothing; None where none is told."""
    own = [p for p in document["parameters"] if p["effect"] == effect and (p["sigma"] or 0.0) > 0.0]
    off = [truth[p["name"]] / p["sigma"] for p in own]
    return math.sqrt(sum(x * x for x in off)) if off else None


def _calibrated(file: Path, names: Sequence[str], assume: str = "fixed-point") -> Mapping[str, Any]:
    """What `handcal calibrate --json` says of a recording that is told these effects."""
    import handcal
    from handcal.show.calibration.summary import calibration_json

    return calibration_json(handcal.calibrate(str(file), effects=names, assume=assume))


def _course(name: str, t: Array, law: Sequence[Added], columns: Sequence[Array]) -> Effect:
    """An effect that adds these columns (n, m), of each channel of the law, by its size and by the
    change of each of its numbers, of which no more is known than their range."""
    from handcal.effects import Effect, Param
    from handcal.effects._linear import added

    def features(signals: Signals) -> list[tuple[int, int, Array]]:
        at = signals.t - signals.t[0]
        return [
            (column_of(one.strange.channel), 0,
             np.stack([np.interp(at, t - t[0], c) for c in own.T], axis=1))
            for one, own in zip(law, columns, strict=True)
        ]  # fmt: skip

    numbers = tuple(Param(f"n{n}", "1", RANGE) for n in range(1, columns[0].shape[1]))
    return Effect(
        id=name, title="The law itself", parameters=(Param("size", "1", 10.0), *numbers),
        story="", source="", motion="", validated="", imu_error=added(features), features=features,
    )  # fmt: skip


_TOLD: Mapping[
    str, Callable[[Ticket, Answer, Path, Mapping[str, float]], dict[str, float]]
] = {"budget": _budget, "strange": _strange, "latest": _strange, "ordinary": _ordinary}  # fmt: skip
