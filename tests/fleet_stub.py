"""Stand-ins for the work of a fleet: what becomes of a recording stands in the file itself."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from handcal.fleet.remote import fetched
from handcal.types import InputError


def work(request):
    """A file of two words: what to do, and a value of gyro_scale x."""
    with fetched(request["path"]) as (path, sha256):
        what, _, value = path.read_text().partition(" ")
    marks = os.environ.get("FLEET_MARKS")
    if marks:
        with (Path(marks) / path.name).open("a") as file:
            file.write("begun\n")
    if what == "refuse":
        raise InputError(f"{path.name} is not a recording.")
    if what == "bug":
        raise ZeroDivisionError("a bug of ours")
    if what == "hang":
        time.sleep(600.0)
    if what == "eat":
        eaten = [bytearray(os.urandom(1 << 20)) * 40 for _ in range(1000)]
        del eaten
    if what == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "segfault":
        os.kill(os.getpid(), signal.SIGSEGV)
    if what == "slow":
        time.sleep(0.3)
    told = {"effect": "gyro_scale", "name": "x", "value": float(value or 0.0), "sigma": 0.001,
            "unit": "1", "prior_sigma": 0.01, "together": True}  # fmt: skip
    every = [told]
    if what == "worn":
        # (in a hand and a room of its own, beside the device's own error)
        for effect, unit, size in (("lever_arm", "m", 0.1), ("mag_hard_iron", "tesla", 5e-5),
                                   ("mag_gradient", "tesla/m", 1e-5)):  # fmt: skip
            name = "x" if effect != "mag_gradient" else "xx"
            every.append(
                told
                | {
                    "effect": effect,
                    "name": name,
                    "unit": unit,
                    "sigma": size / 50,
                    "value": size * float(value) / 0.01,
                    "prior_sigma": size,
                }
            )
    known = {"information": {"names": [], "b": "", "G": ""}, "laws": {"count": 0, "told": ""}}
    if what == "untold":
        known, every = {"untold": "No fit holds with what every device has."}, []
    return {
        "recording": {
            "path": request["path"], "duration_s": 20.0, "imu_rate_hz": 100.0, "streams": ["imu"],
            "assume": "fixed-point", "sha256": "", "recorded": "2026-05-01T10:00:00Z",
        },
        "device": "", "model": "",
        "gravity": 9.8, "verdict": "explained", "named": [], "unnamed": [], "hypotheses": [],
        "told": every, "held_out": {}, "warnings": [], "trust": "good",
        "trust_reasons": [], "explanation": {"stub": True},
        "fetched": sha256,
    } | known  # fmt: skip
