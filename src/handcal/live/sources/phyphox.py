"""The phyphox app, asked through its remote interface for what is new.

``/config`` names the buffers of each sensor, ``/meta`` the device, ``/control?cmd=start`` begins
to measure, ``/get?gyr_time=T&gyrX=T|gyr_time&...`` gives what was measured after experiment time
T, ``/time`` says at which system time the experiment time began and went on after pauses. A buffer
holds as much as the experiment says (0: everything); what is not asked for in time is a gap.
"""

from __future__ import annotations

import http.client
import json
import math
import urllib.parse
import urllib.request
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.live.session import Batch, Session
from handcal.live.sources.pairing import Pairing
from handcal.types import Array, HandcalError, InputError, IntArray

SENSORS = {"gyro": "gyroscope", "accel": "accelerometer", "mag": "magnetic_field"}
FACTOR = {"gyro": 1.0, "accel": 1.0, "mag": 1e-6}
# phyphox makes m/s^2 of an iPhone's g by this.
PHYPHOX_G = 9.81
PATIENCE_S = 5.0
# An answer may hold a minute of three sensors at 400 Hz.
LARGEST = 16 * 2**20
Readings = tuple[IntArray, Array]


@dataclass
class Phone:
    """A phyphox that answers. address: http://HOST:PORT. buffers: by sensor, the names of x, y, z
    and time; last: experiment time up to which each has been read, s; starts: experiment and
    system time (k, 2), s, of each beginning; begun, ended: whether it has been seen measuring, and
    was stopped on the phone since."""

    address: str
    buffers: Mapping[str, tuple[str, str, str, str]]
    apple: bool
    last: dict[str, float] = field(default_factory=dict)
    starts: Array = field(default_factory=lambda: np.zeros((0, 2)))
    pairing: Pairing = field(default_factory=Pairing)
    experiment: str = ""
    begun: bool = False
    ended: bool = False

    def poll(self, into: Session) -> int:
        """Record what is new; how many samples. Errors: HandcalError, Refused; OSError where it
        does not answer."""
        kept = into.note.get("phyphox", {})
        if not self.experiment and kept:
            self.experiment, self.last = kept["experiment"], dict(kept["last"])
        tree = _asked(self.address, f"/get?{self._query()}")
        status, held = tree.get("status", {}), tree.get("buffer", {})
        name, measuring = str(status.get("session", "")), bool(status.get("measuring"))
        if self.experiment and name != self.experiment:
            raise HandcalError("phyphox has begun another experiment; this recording ends here.")
        self.experiment = name
        if not measuring and not self.begun:
            _asked(self.address, "/control?cmd=start")
        self.ended = self.begun and not measuring
        self.begun = self.begun or measuring
        if not len(self.starts):
            self.starts = _starts(self.address)
            if not len(self.starts):
                return 0
        return self._record(into, {kind: self._readings(kind, held) for kind in self.buffers})

    def _record(self, into: Session, found: Mapping[str, Readings]) -> int:
        self.pairing.add(found["gyro"], found["accel"])
        ns, rate, force = self.pairing.ready()
        further = {"mag": found["mag"]} if "mag" in found and len(found["mag"][0]) else {}
        note = {"phyphox": {"experiment": self.experiment, "last": dict(self.last)}}
        if len(ns) or further:
            client = f"phyphox {self.experiment}"
            into.take(Batch(client, into.next, ns, rate, force, further=further, note=note))
        return len(ns)

    def _query(self) -> str:
        """Of each sensor what comes after the last time that was read."""
        parts = []
        for kind, (*axes, t) in self.buffers.items():
            after = f"{self.last.get(kind, -1.0):.9f}"
            parts += [f"{axis}={after}|{t}" for axis in axes] + [f"{t}={after}"]
        return urllib.parse.quote("&".join(parts), safe="=&.-")

    def _readings(self, kind: str, held: Mapping[str, Any]) -> Readings:
        rows = [_numbers(held.get(name)) for name in self.buffers[kind]]
        n = min(map(len, rows))  # (a buffer may have been filled while the answer was written)
        table = np.array([row[:n] for row in rows], dtype=np.float64).reshape(4, n).T
        fresh = np.isfinite(table).all(axis=1) & (table[:, 3] > self.last.get(kind, -np.inf))
        table = table[fresh]
        if len(table):
            self.last[kind] = float(table[-1, 3])
        factor = FACTOR[kind]
        if kind == "accel" and self.apple:
            factor *= STANDARD_GRAVITY / PHYPHOX_G
        return _stamps(table[:, 3], self.starts), factor * table[:, :3]


def found(address: str) -> Phone:
    """The phone at this address, measuring. Errors: InputError where there is no phyphox, or its
    experiment lacks a sensor."""
    if "//" not in address:
        address = f"http://{address}"
    address = address.rstrip("/")
    try:
        config, meta = _asked(address, "/config"), _asked(address, "/meta", {})
    except (OSError, HandcalError) as error:
        raise InputError(
            f"No phyphox answers at {address} ({error}): open an experiment, allow remote access "
            "in its menu, and give the address that it shows."
        ) from error
    buffers = {}
    for kind, source in SENSORS.items():
        for one in config.get("inputs", []):
            if isinstance(one, dict) and one.get("source") == source:
                outputs = {k: v for o in one.get("outputs", []) for k, v in o.items()}
                if all(axis in outputs for axis in "xyzt"):
                    buffers[kind] = tuple(str(outputs[axis]) for axis in "xyzt")
    missing = [SENSORS[k] for k in ("gyro", "accel") if k not in buffers]
    if missing:
        raise InputError(
            f"The experiment at {address} does not record {' and '.join(missing)}: in phyphox, "
            "make an experiment of your own with gyroscope and accelerometer (with g)."
        )
    brand = f"{meta.get('deviceBrand', '')} {meta.get('deviceManufacturer', '')}".lower()
    return Phone(address, buffers, "apple" in brand)  # type: ignore[arg-type]


def _starts(address: str) -> Array:
    """Experiment and system time (k, 2) of each beginning, s."""
    events = _asked(address, "/time", [])
    rows = [
        [float(e["experimentTime"]), float(e["systemTime"])]
        for e in events
        if isinstance(e, dict) and e.get("event") == "START"
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 2)


def _stamps(t: Array, starts: Array) -> IntArray:
    """Experiment time (n,) as ns since 1970."""
    begun = np.clip(np.searchsorted(starts[:, 0], t, side="right") - 1, 0, None)
    since = np.rint((t - starts[begun, 0]) * 1e9).astype(np.int64)
    ns: IntArray = since + np.rint(starts[begun, 1] * 1e6).astype(np.int64) * 1000
    return ns


def _numbers(buffer: Any) -> Sequence[float]:
    """The numbers of a buffer in an answer; what is none is NaN."""
    values = buffer.get("buffer") if isinstance(buffer, dict) else None
    if not isinstance(values, list):
        return []
    return [float(v) if type(v) in (int, float) else math.nan for v in values]


def _asked(address: str, path: str, otherwise: Any = None) -> Any:
    """The JSON that it answers. Errors: OSError; HandcalError for what is no JSON; with
    ``otherwise``, that instead."""
    try:
        with urllib.request.urlopen(address + path, timeout=PATIENCE_S) as answer:
            body = answer.read(LARGEST + 1)
        if len(body) > LARGEST:
            raise HandcalError(f"phyphox sent more than {LARGEST // 2**20} MB at once.")
        return json.loads(body)
    except (ValueError, RecursionError, http.client.HTTPException, OSError) as error:
        if otherwise is not None:
            return otherwise
        if isinstance(error, OSError):
            raise
        raise HandcalError(f"{address} does not answer as phyphox does.") from error
