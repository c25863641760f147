"""What stands in the results of the simulator: a type for each kind, and its JSON Schema."""

from __future__ import annotations

from handcal.results.json_schema import Schema, json_schema
from handcal_sim.results import prove, prove_fleet, prove_live, simulate, sweep

RESULTS: dict[str, tuple[str, type]] = {
    "prove-answers": ("handcal prove --out", prove.Answers),
    "prove-fleet": ("handcal prove --suite fleet --json", prove_fleet.FleetProof),
    "prove-live": ("handcal prove --suite live --json", prove_live.LiveProof),
    "prove": ("handcal prove --json", prove.Proof),
    "simulate": ("handcal simulate", simulate.Truth),
    "sweep-cell": ("handcal sweep --out", sweep.SweepCell),
    "sweep": ("handcal sweep --json", sweep.Sweep),
}


def schemas() -> dict[str, Schema]:
    """JSON Schema (draft 2020-12) of each, as ``handcal.results.schemas``."""
    return {name: json_schema(name, *of) for name, of in RESULTS.items()}
