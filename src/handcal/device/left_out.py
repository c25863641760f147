"""What a device file does not keep of a result, and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from handcal.device.file import kept
from handcal.effects import Effect, catalogue

UNKNOWN = "no effect of the catalogue"
NOISE = "noise, which is each recording's own"
PLACE = "of the place, not of the device"
ONE_DAY = "of one day or one moment"
STREAM = (
    "of a stream beside gyro and accelerometer, and another day another: magnets near the device, "
    "the program that wrote the stamps"
)


def not_kept(document: Mapping[str, Any]) -> Mapping[str, tuple[str, ...]]:
    """Ids of the effects of a result, of which ``file.session_of`` has made a session, that a
    device file does not keep, by reason."""
    blocks = [document, *document.get("recordings", [])]
    ids = dict.fromkeys(
        (str(p["effect"]), str(p["name"]))
        for b in blocks
        for p in b.get("parameters", [])
        if p.get("shown", True)
    )
    out: dict[str, dict[str, None]] = {}
    for effect, name in ids:
        if not kept((effect, name)):
            out.setdefault(_reason(catalogue().get(effect)), {})[effect] = None
    return {reason: tuple(found) for reason, found in out.items()}


def sentence(left: Mapping[str, tuple[str, ...]]) -> str:
    """One sentence of it; empty if all is kept."""
    parts = [f"{', '.join(ids)} ({reason})" for reason, ids in left.items()]
    return f"Not kept: {'; '.join(parts)}." if parts else ""


def _reason(effect: Effect | None) -> str:
    if effect is None:
        return UNKNOWN
    if effect.process is not None or effect.outliers:
        return NOISE
    if effect.of_one_day or effect.moments is not None:
        return ONE_DAY
    return PLACE if effect.world else STREAM
