"""The process that calibrates recordings for `ordinary`, each told by its path alone.

`priors.toml` in a recording's folder is what is known of its class. Where `again` holds another
recording of the same name, what was learnt is taken off it, and `corrected` holds what comes of it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from handcal_sim.prove.ordinary_devices import COMMON, shows
from handcal_sim.prove.workers import serve

# All that every device has, as far as a recording's streams can show it.
ALL_COMMON = "common"
PRIORS, AGAIN, CORRECTED = "priors.toml", "again", "corrected"


def calibrated(effects: str, path: str) -> Mapping[str, Any]:
    """What `handcal calibrate FILE --effects EFFECTS --json` says of a recording."""
    from handcal.commands.calibrate import calibrate

    file = Path(path)
    priors, again = file.with_name(PRIORS), file.parent / AGAIN / file.name
    out = file.with_suffix(".json")
    if effects == ALL_COMMON:
        effects = ",".join(_common(file))
    calibrate([file], effects=effects, json=out, priors=priors if priors.exists() else None)
    if again.exists():
        _corrected(again, out, file.parent / CORRECTED / file.name)
    document: Mapping[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return document


def _common(file: Path) -> list[str]:
    import handcal

    there = frozenset(handcal.load(file).streams)
    cold = "temperature" not in there
    return [n for n in COMMON if shows(n, there) and not (cold and n.endswith("_temperature"))]


def _corrected(again: Path, learnt: Path, out: Path) -> None:
    from handcal.commands.apply import apply
    from handcal.types import HandcalError

    out.parent.mkdir(exist_ok=True)
    try:
        apply(again, learnt_from=learnt, out=out)
    except HandcalError as error:
        # (nothing that could be taken off: it stays as it is)
        out.with_suffix(".txt").write_text(str(error), encoding="utf-8")


if __name__ == "__main__":
    serve(partial(calibrated, sys.argv[1] if sys.argv[1:] else ""))
