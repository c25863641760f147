"""What `calibrate` leaves of a gyro's error if it is told the names of all that is there: what no
explanation has to beat."""

from __future__ import annotations

from pathlib import Path

from handcal_sim.prove.draw_budget import left
from handcal_sim.prove.given import Ticket
from handcal_sim.prove.score_budget import MEDIAN
from handcal_sim.prove.suites import Answer


def told(ticket: Ticket, answer: Answer, file: Path, share_left: float | None) -> dict[str, float]:
    """{"told": share of the gyro's error that is left} where an explanation leaves more than is
    asked in the median; nothing elsewhere, and of other suites."""
    if share_left is None or share_left <= MEDIAN or ticket.suite != "budget":
        return {}
    import handcal
    from handcal.show.calibration.summary import calibration_json

    names = list(answer.effects)
    result = handcal.calibrate(str(file), effects=names, assume="fixed-point")
    return {"told": left(ticket, calibration_json(result))["share_left"]}
