"""Batches of the page: what its sensors read as JSON, taken to SI and to the axes of the house.

``{"client": "...", "seq": 0, "agent": "ios" | "android" | "other", "api": "motion" | "sensor",
"t": [ms since 1970, ...], "gyro": [[x, y, z], ...], "accel": [[x, y, z], ...]}``, the latter m/s^2
with gravity, and if there is one ``"heading": [[ms, deg], ...]``, the yaw of body x,
counter-clockwise from east.

api. "motion" (and where it is missing): DeviceMotion events, the gyro's rates in deg/s as alpha,
beta, gamma. "sensor": the Generic Sensor API, rad/s about x, y, z, signs as in its specification,
each force taken at the stamp of a rate by the page.

Axes. The first editions of the specification, and pages written after them, have alpha about z,
beta about x and gamma about y. Chrome, Firefox and Safari all give alpha about x, beta about y and
gamma about z, and the specification was changed to say so (w3c/deviceorientation, issue 44 and
pull request 43). The latter is the first guess here. The first turns decide: while a device
turns in place, gravity moves in its axes as the gyro says, and with permuted axes it does not.

Sign. By the specification, a device that lies on its back reads +g on z; Safari on iOS reads -g.
The turns cannot tell the sign: the first guess is by the user agent, and the page asks to begin
with the device on its back, which decides.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from handcal.live.session import Batch, Refused
from handcal.types import Array, IntArray

# How a page comes by its readings, and what is said of it at the end.
MOTION, SENSOR = "motion", "sensor"
APIS = {
    MOTION: "The page was told by DeviceMotion events, whose stamps are the events' own: readings "
    "may be some milliseconds older.",
    SENSOR: "The page read its sensors by the Generic Sensor API: stamps are the gyro's readings', "
    "and the accelerometer was taken at them.",
}
MOST = 2000  # samples in a batch
LIMITS = {"t": 2.147e12, "gyro": 1e5, "accel": 1e4, "heading": 2.147e12}
LONGEST_CLIENT = 64
OLD_ORDER = (1, 2, 0)  # where x, y, z stand if alpha is about z
ENOUGH_RAD = np.pi / 2
CLEARLY = 0.5  # of the other's squared residual
STEP_S, FIRST_S, FLAT = 0.1, 1.0, 0.8


@dataclass(frozen=True)
class Convention:
    """What has to be changed in readings that were taken by the first guess: order of the gyro's
    axes, sign of the accelerometer; sentences say so."""

    order: tuple[int, int, int] = (0, 1, 2)
    sign: int = 1
    sentences: tuple[str, ...] = ()


def parse(body: bytes) -> Batch:
    """A batch in SI. Errors: Refused, with what is wrong in it."""
    try:
        tree = json.loads(body)
    except (ValueError, RecursionError):
        raise Refused(400, "This is not JSON.") from None
    client, seq = (tree.get("client"), tree.get("seq")) if isinstance(tree, dict) else (None, None)
    if not isinstance(client, str) or not 0 < len(client) <= LONGEST_CLIENT:
        raise Refused(400, "client: expected a short name.")
    if type(seq) is not int or not 0 <= seq < 2**53:
        raise Refused(400, "seq: expected a whole number.")
    t = _numbers(tree, "t", 0)
    gyro, accel = _numbers(tree, "gyro", 3), _numbers(tree, "accel", 3)
    if not len(t) == len(gyro) == len(accel):
        raise Refused(400, "t, gyro and accel: expected as many of each.")
    further = {}
    if tree.get("heading"):
        rows = _numbers(tree, "heading", 2)
        yaw = np.radians(rows[:, 1:])
        further["heading"] = (_ns(rows[:, 0]), np.arctan2(np.sin(yaw), np.cos(yaw)))
    api = tree.get("api", MOTION)
    if api not in APIS:
        raise Refused(400, f"api: expected one of {', '.join(APIS)}.")
    sign = -1.0 if tree.get("agent") == "ios" and api == MOTION else 1.0
    rate = np.radians(gyro) if api == MOTION else gyro
    return Batch(client, seq, _ns(t), rate, sign * accel, further, {"api": api})


def _ns(ms: Array) -> IntArray:
    if np.any(ms < 0):
        raise Refused(400, "t: expected milliseconds since 1970.")
    return np.rint(ms * 1e6).astype(np.int64)


def _numbers(tree: dict[str, Any], name: str, width: int) -> Array:
    """A list of numbers (n,), or with a width of rows (n, width), finite and within bounds."""
    given = tree.get(name)
    if not isinstance(given, list) or len(given) > MOST:
        raise Refused(400, f"{name}: expected a list of at most {MOST}.")
    if width and not all(isinstance(row, list) and len(row) == width for row in given):
        raise Refused(400, f"{name}: expected rows of {width} numbers.")
    flat = [x for row in given for x in row] if width else given
    if not all(type(x) in (int, float) and abs(x) <= LIMITS[name] for x in flat):
        raise Refused(400, f"{name}: expected finite numbers of a possible size.")
    return np.array(given, dtype=np.float64).reshape((-1, width) if width else -1)


def told(t: Array, gyro: Array, accel: Array) -> Convention | None:
    """What the first rest and the first turns say of the first guess; None while they do not yet.

    t (n,) s, gyro (n, 3) rad/s, accel (n, 3) m/s^2, as taken by the first guess.
    """
    n = max(1, round(STEP_S / float(np.median(np.diff(t))))) if len(t) > 2 else 0
    k = len(t) // n if n else 0
    if k < 3:
        return None
    mean = [x[: k * n].reshape(k, n, 3).mean(axis=1) for x in (gyro, accel)]
    step = np.diff(t[: k * n : n])[:, None]
    rate, force = 0.5 * (mean[0][1:] + mean[0][:-1]), 0.5 * (mean[1][1:] + mean[1][:-1])
    if float((np.linalg.norm(rate, axis=1) * step[:, 0]).sum()) < 2 * ENOUGH_RAD:
        return None
    moved = np.diff(mean[1], axis=0)
    left = [
        float(((moved + np.cross(rate[:, list(order)], force) * step) ** 2).sum())
        for order in ((0, 1, 2), OLD_ORDER)
    ]
    sentences = []
    order = (0, 1, 2)
    if left[1] < CLEARLY * left[0]:
        order = OLD_ORDER
        sentences.append("The turns say that this browser's alpha is about z: axes are exchanged.")
    elif left[0] > CLEARLY * left[1]:
        return None
    first = accel[t - t[0] < FIRST_S].mean(axis=0)
    up = first[2] / max(float(np.linalg.norm(first)), 1e-9)
    if up < -FLAT:
        sentences.append("It began on its back with gravity upside down: the sign is changed.")
    elif up < FLAT:
        sentences.append("It did not begin on its back: the sign of gravity is a guess.")
    return Convention(order, -1 if up < -FLAT else 1, tuple(sentences))
