"""What the app Sensor Logger pushes by HTTP: a JSON object a batch.

``{"messageId": 0, "sessionId": "...", "deviceId": "...", "payload": [{"name": "gyroscope", "time":
ns since 1970, "values": {"x": ..., "y": ..., "z": ...}}, ...]}``. ``messageId`` counts the batches
of a recording from 0; the app does not send a batch again that was lost, so a number that is
missing is a gap, which is counted and said. A number that was there already is a repetition.

Raw classes are taken where they are among the first readings, else the corrected ones. Units and
signs as in its exports: the uncalibrated accelerometer of iOS is in g with the other sign; which
of them it is, gravity tells.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.live.session import Batch, Refused, Session
from handcal.live.sources.pairing import Pairing
from handcal.types import Array, IntArray

GYROS = ("gyroscopeuncalibrated", "gyroscope")
ACCELS = ("accelerometeruncalibrated", "totalacceleration")
MAGS = ("magnetometeruncalibrated", "magnetometer")
# With these two, the force is their sum: what the phone makes of gravity, and the rest.
PARTS = ("accelerometer", "gravity")
KNOWN = {*GYROS, *ACCELS, *MAGS, *PARTS}
# Readings of a batch: ten seconds of eight sensors at 400 Hz.
MOST = 32_000
# Beyond these no phone's reading lies, rad/s, m/s^2 or g, microtesla.
LIMITS = {"gyro": 2e3, "accel": 2e3, "mag": 1e6}
# A stamp before 2001 or after 2090 is no time of a phone that knows the day.
TIMES = (10**18, 38 * 10**17)
# Between 1 (g) and 9.8 (m/s^2): what an accelerometer reads at rest in its own unit.
BETWEEN_UNITS = 3.0

Readings = tuple[IntArray, Array]


@dataclass(frozen=True)
class Message:
    """One push: whose, its number, and by sensor stamps (n,) ns and readings (n, 3) as sent."""

    session: str
    number: int
    sensors: Mapping[str, Readings]


@dataclass
class Pushed:
    """What has been pushed so far. missing: numbers that never came; unit: of the accelerometer,
    to m/s^2 with Android's sign, 0 before it is known."""

    session: str = ""
    number: int = -1
    missing: int = 0
    unit: float = 0.0
    chosen: dict[str, str] = field(default_factory=dict)
    pairing: Pairing = field(default_factory=Pairing)

    def take(self, body: bytes, into: Session) -> None:
        """Record a push. Errors: Refused."""
        message = parse(body)
        if not self.session:
            kept = into.note.get("push", {})
            self.session, self.number = kept.get("session", ""), kept.get("number", -1)
        if message.session == self.session and message.number <= self.number:
            into.hello(f"push {message.session}")
            return
        before = (self.session, self.number, self.missing)
        if message.session == self.session:
            self.missing += message.number - self.number - 1
        self.session, self.number = message.session, message.number
        try:
            self._record(message, into)
        except Refused:
            self.session, self.number, self.missing = before
            raise

    def _record(self, message: Message, into: Session) -> None:
        self._choose(message.sensors)
        gyro, mag = (self._of(message.sensors, kind) for kind in ("gyro", "mag"))
        self.pairing.add(gyro, self._force(message.sensors))
        ns, rate, force = self.pairing.ready()
        further = {"mag": (mag[0], mag[1] * 1e-6)} if len(mag[0]) else {}
        note = {"push": {"session": self.session, "number": self.number}}
        into.take(
            Batch(f"push {self.session}", into.next, ns, rate, force, further=further, note=note)
        )

    def _choose(self, sensors: Mapping[str, Readings]) -> None:
        """Of each kind one sensor, for good: the best that is there when the first comes."""
        for kind, names in (("gyro", GYROS), ("accel", ACCELS), ("mag", MAGS)):
            there = [n for n in names if n in sensors]
            if there:
                self.chosen.setdefault(kind, there[0])
        if all(part in sensors for part in PARTS):
            self.chosen.setdefault("accel", PARTS[0])

    def _of(self, sensors: Mapping[str, Readings], kind: str) -> Readings:
        none = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        return sensors.get(self.chosen.get(kind, ""), none)

    def _force(self, sensors: Mapping[str, Readings]) -> Readings:
        ns, value = self._of(sensors, "accel")
        if self.chosen.get("accel") == PARTS[0] and len(ns):
            at, gravity = sensors.get(PARTS[1], (ns[:0], value[:0]))
            if not len(at):
                return ns[:0], value[:0]
            zero = at[0]
            value = value + np.column_stack(
                [np.interp((ns - zero) / 1e9, (at - zero) / 1e9, axis) for axis in gravity.T]
            )
        if not self.unit and len(ns):
            usual = float(np.median(np.linalg.norm(value, axis=1)))
            self.unit = -STANDARD_GRAVITY if usual < BETWEEN_UNITS else 1.0
        return ns, value * self.unit


def parse(body: bytes) -> Message:
    """A push, its readings checked. Errors: Refused, with what is wrong in it."""
    try:
        tree = json.loads(body)
    except (ValueError, RecursionError):
        raise Refused(400, "This is not JSON.") from None
    if not isinstance(tree, dict):
        raise Refused(400, "A push is an object with messageId, sessionId and payload.")
    number, session, payload = (tree.get(k) for k in ("messageId", "sessionId", "payload"))
    if type(number) is not int or not 0 <= number < 2**53:
        raise Refused(400, "messageId: expected a whole number.")
    if not isinstance(session, str) or not 0 < len(session) <= 128:
        raise Refused(400, "sessionId: expected a short name.")
    if not isinstance(payload, list) or len(payload) > MOST:
        raise Refused(400, f"payload: expected a list of at most {MOST} readings.")
    rows: dict[str, list[Any]] = {}
    for entry in payload:
        if not isinstance(entry, dict):
            raise Refused(400, "payload: expected objects.")
        name = str(entry.get("name")).lower()
        if name in KNOWN:
            rows.setdefault(name, []).append(entry)
    return Message(session, number, {name: _readings(name, some) for name, some in rows.items()})


def _readings(name: str, entries: list[dict[str, Any]]) -> Readings:
    kind = "gyro" if name in GYROS else "mag" if name in MAGS else "accel"
    times, values = [], []
    for entry in entries:
        time, at = entry.get("time"), entry.get("values")
        row: list[Any] = [at.get(axis) for axis in "xyz"] if isinstance(at, dict) else []
        if type(time) is not int or not TIMES[0] < time < TIMES[1]:
            raise Refused(400, f"{name}: expected a time in ns since 1970.")
        if len(row) != 3 or not all(type(x) in (int, float) and abs(x) < LIMITS[kind] for x in row):
            raise Refused(400, f"{name}: expected finite x, y and z of a possible size.")
        times.append(time)
        values.append(row)
    ns = np.array(times, dtype=np.int64)
    order = np.argsort(ns, kind="stable")
    return ns[order], np.array(values, dtype=np.float64)[order]
