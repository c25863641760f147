"""What `calibrate` leaves if it is told all that is there, the names or the very law: what no
explanation has to beat."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from handcal_sim.prove import draw_budget, draw_strange
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
# A moment, and which readings are wrong.
_UNTOLD = ("gyro_bias_step", "heading_outliers")


def told(
    ticket: Ticket, answer: Answer, file: Path, further: Mapping[str, float]
) -> dict[str, float]:
    """Shares left of what an explanation leaves more of than is asked: "told" of a gyro's error
    (suite budget), "told_1" and so on of laws (suite strange), and how probable these make the
    recording."""
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


def _calibrated(file: Path, names: Sequence[str]) -> Mapping[str, Any]:
    """What `handcal calibrate --json` says of a recording that is told these effects."""
    import handcal
    from handcal.show.calibration.summary import calibration_json

    return calibration_json(handcal.calibrate(str(file), effects=names, assume="fixed-point"))


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
] = {"budget": _budget, "strange": _strange, "latest": _strange}  # fmt: skip
