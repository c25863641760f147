"""What ``handcal bench --json`` writes."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from handcal.bench.timing import Figure, Profile, Row, Skipped

SCHEMA = "handcal/bench/1"


def document(
    found: Sequence[Row], left: Sequence[Skipped], rounds: int, load: float | None
) -> dict[str, Any]:
    """All that was found so far; left: what is not measured, or not to its end, so that the
    document is not complete. load: share of the processors that were busy before."""
    rows = (*found, *left)
    return {
        "schema": SCHEMA, "machine": _machine(load), "rounds": rounds, "complete": not left,
        "figures": [_figure(f) for f in rows if isinstance(f, Figure)],
        "profiles": [asdict(p) for p in rows if isinstance(p, Profile)],
        "skipped": [asdict(s) for s in rows if isinstance(s, Skipped)],
    }  # fmt: skip


def _figure(figure: Figure) -> dict[str, Any]:
    target = figure.target
    return {
        "group": figure.group, "title": figure.title, "unit": figure.unit,
        "clock": figure.clock or None, "median": figure.value, "rounds": figure.rounds.tolist(),
        "target": target and {"at_most" if target.at_most else "at_least": target.value},
        "met": figure.met,
    }  # fmt: skip


def _machine(load: float | None) -> dict[str, Any]:
    names = ("handcal", "numpy", "numba")
    return {
        "processor": platform.processor() or platform.machine(), "cores": os.cpu_count(),
        "system": platform.system(), "python": platform.python_version(),
        "load_before": load, "versions": {name: version(name) for name in names},
    }  # fmt: skip
