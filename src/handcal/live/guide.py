"""What to do next, told by what has been done: rest, a turn about each axis and back, rest."""

from __future__ import annotations

from typing import Any

import numpy as np

from handcal.types import Recording

REST_S, STILL_RAD_S = 3.0, np.radians(4.0)
# (there and back, less what slow ends and hasty hands leave out)
TURN_RAD, TURNING_RAD_S = 3.6 * np.pi, np.radians(10.0)
REST = "Lay it down on its back, screen up, and leave it there."
TURNS = (
    "Hold it where it is and turn it once about its x axis (to the right) and back, slowly.",
    "Hold it where it is and turn it once about its y axis (to the top) and back, slowly.",
    "Hold it where it is and turn it once like a plate on the table and back, slowly.",
)
LAY_DOWN = "Lay it down again, screen up."
ENOUGH = "That is enough: press Stop, or go on turning to know more."


def next_turn(recording: Recording | None) -> dict[str, Any]:
    """The sentence, and which share (0 to 1) of it has been done."""
    if recording is None:
        return {"say": REST, "done": 0.0}
    imu = recording.imu
    step = np.clip(np.diff(imu.t, append=imu.t[-1]), 0.0, 0.1)
    size = np.linalg.norm(imu.gyro, axis=1)
    still = size < STILL_RAD_S
    moved = np.flatnonzero(~still)
    rested = float(step[still].sum())
    if rested < REST_S and len(moved) * float(np.median(step)) < REST_S:
        return {"say": REST, "done": rested / REST_S}
    turning = size > TURNING_RAD_S
    turned = (np.abs(imu.gyro) * (turning * step)[:, None]).sum(axis=0) / TURN_RAD
    for axis, sentence in enumerate(TURNS):
        if turned[axis] < 1.0:
            return {"say": sentence, "done": round(float(turned[axis]), 3)}
    last = float(imu.t[-1] - imu.t[moved[-1]]) if len(moved) else 0.0
    if last < REST_S:
        return {"say": LAY_DOWN, "done": round(last / REST_S, 3)}
    return {"say": ENOUGH, "done": 1.0}
