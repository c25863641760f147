"""What is known of real devices from elsewhere, against ``explain``: other
people's calibrations and instruments, with the tolerance to which they are to be believed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from proved import proved

import handcal
from handcal.explain import explain
from handcal.types import Parameter


@dataclass(frozen=True)
class Fact:
    """Parameters of an effect as somebody else has them, SI, and a tolerance."""

    effect: str
    names: str
    values: tuple[float, ...]
    within: float


# What the phone itself takes its iron to be.
_XIAOMI = Fact("mag_hard_iron", "x y z", (4.6e-6, 14.6e-6, 150.3e-6), 8e-6)
# A hand that turns about no single point, iron that is nearby: all of it may be untellable.
QUICK = "phone_oscillations3"
PHONES = {"android_fullyaw", "android_fullpitch", "phone_oscillations1", "phone_oscillations3"}
FACTS = {
    "xsens_poses": (
        Fact("accel_scale", "x y z", (-0.0013, -0.0070, -0.0011), 0.003),
        Fact("accel_misalignment", "yx zx zy", (0.0035, 0.0090, 0.0213), 0.004),
        Fact("accel_bias", "x y z", (0.858, 1.222, -0.973), 0.02),
        Fact("gyro_scale", "x y z", (-0.0046, -0.0063, -0.0054), 0.008),
        Fact("gyro_misalignment", "xy xz yx yz zx zy",
             (-0.0095, -0.0102, -0.0056, 0.0321, -0.0163, 0.0240), 0.012),
        Fact("gyro_bias", "x y z", (0.0019, -0.0642, -0.0534), 0.002),
    ),
    "nilspod_ferraris": (
        Fact("accel_scale", "x y z", (-0.0033, 0.0024, 0.0234), 0.006),
        Fact("accel_misalignment", "yx zx zy", (-0.0063, 0.0060, 0.0041), 0.01),
        Fact("accel_bias", "x y z", (0.537, -0.616, 0.399), 0.06),
        Fact("gyro_scale", "x y z", (0.0278, -0.0177, -0.0017), 0.01),
        Fact("gyro_misalignment", "xy xz yx yz zx zy",
             (0.0148, 0.0011, -0.0148, -0.0046, 0.0021, 0.0096), 0.02),
        Fact("gyro_bias", "x y z", (-0.0105, -0.0065, 0.0010), 0.002),
    ),
    "openaxes_circle250": (Fact("gyro_scale", "x", (-0.0172,), 0.005),),
    "euroc_v203": (
        Fact("lever_arm", "x y z", (-0.069, 0.028, 0.124), 0.015),
        Fact("pose_delay", "delay", (-0.199,), 0.012),
        Fact("gyro_bias", "x y z", (-0.0016, 0.0247, 0.0805), 0.002),
    ),
    "array_6_imu5": (
        Fact("lever_arm", "x y z", (0.0189, 0.0, 0.0), 0.001),
        Fact("gyro_scale", "x y z", (0.0058, -0.0061, 0.0024), 0.003),
    ),
    "broad_32_magnet": (Fact("mag_hard_iron", "x y z", (-6.2e-6, -1.2e-6, 58.2e-6), 3e-6),),
    "broad_07": (
        Fact("lever_arm", "z", (0.009,), 0.004),
        Fact("pose_delay", "delay", (-0.004,), 0.0015),
    ),
    "android_fullyaw": (_XIAOMI, Fact("heading_delay", "delay", (0.040,), 0.015)),
    "android_fullpitch": (_XIAOMI, Fact("heading_delay", "delay", (0.040,), 0.015)),
    "phone_oscillations1": (Fact("lever_arm", "x y", (0.027, 0.063), 0.012),),
    "phone_oscillations3": (
        Fact("lever_arm", "x y", (0.020, 0.029), 0.012),
        Fact("heading_delay", "delay", (0.040,), 0.015),
    ),
    "iphone_arkit": (
        Fact("mag_hard_iron", "x y z", (538.7e-6, -129.2e-6, -108.3e-6), 8e-6),
        Fact("gyro_bias", "x y z", (-0.0084, -0.0016, 0.0165), 0.002),
    ),
}  # fmt: skip


def _arm(parameters: Sequence[Parameter]) -> dict[tuple[str, str], Parameter]:
    """The lever arm that three accelerometers at their own places have in common (where there is
    no other: then the size effect counts from the reference point)."""
    places = {p.name: p for p in parameters if p.effect == "size_effect"}
    out = {}
    for axis in "xyz" if places else "":
        rows = [places[row + axis] for row in "xyz"]
        value, sigma = sum(p.value for p in rows) / 3.0, max(p.sigma for p in rows)
        out["lever_arm", axis] = replace(rows[0], value=value, sigma=sigma)
    return out


# (one is explained by the quick suite, the others by `make prove`)
@pytest.mark.parametrize("name", [QUICK, *proved(*sorted({*FACTS} - {QUICK}))])
def test_what_is_known_of_a_device_is_found(name: str, real_recordings: Path) -> None:
    """Within the tolerance, sigma below it; at most one in five may be untellable instead (any, of
    a phone in a hand)."""
    begun = time.monotonic()
    found = explain([handcal.load(real_recordings / "devices" / f"{name}.mcap")])
    got = _arm(found.parameters) | {(p.effect, p.name): p for p in found.parameters}
    hidden = {(p.effect, p.name) for p in found.untellable}
    missed, untold, count = [], 0, 0
    effects = ", ".join(f"{m.effect} ({m.log_evidence_gain:.0f})" for m in found.missing)
    print(f"\n{name}: {found.verdict}, {effects}; {time.monotonic() - begun:.0f} s")
    for fact in FACTS[name]:
        for parameter, value in zip(fact.names.split(), fact.values, strict=True):
            key, count = (fact.effect, parameter), count + 1
            p = got.get(key)
            if p is None or p.sigma > fact.within:
                untold += key in hidden
                if key not in hidden and abs(value) > fact.within:
                    missed.append((*key, value, "not told"))
            elif abs(p.value - value) > fact.within:
                missed.append((*key, value, f"{p.value:.4g} +- {p.sigma:.2g}"))
    print(f"  {count} facts, {untold} untellable, missed: {missed}")
    assert not missed
    assert untold <= count / 5 or name in PHONES
