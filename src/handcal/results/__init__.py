"""What stands in the results that are written as JSON: a type for each kind, and its JSON Schema.

A key is a line of its type: name, kind of value, description, and when it is there if not always.
"""

from __future__ import annotations

from handcal.results import (
    allan,
    bench,
    calibrate,
    design,
    device,
    effects,
    explain,
    fleet,
    fleet_recording,
    info,
    lab,
    lab_known_input,
    lab_scalar,
    lab_size,
)
from handcal.results.json_schema import Schema, json_schema

RESULTS: dict[str, type] = {
    "allan": allan.Allan,
    "bench": bench.Bench,
    "calibrate": calibrate.Calibration,
    "design-motion": design.DesignedMotion,
    "design-poses": design.DesignedPoses,
    "device-show": device.DeviceShown,
    "effects": effects.Effects,
    "explain": explain.Explanation,
    "fleet-recording": fleet_recording.FleetRecording,
    "fleet": fleet.Fleet,
    "info": info.Info,
    "lab-known-input": lab_known_input.KnownInput,
    "lab-paper": lab.Paper,
    "lab-scalar": lab_scalar.Scalar,
    "lab-size": lab_size.Size,
    "lab-thermal": lab.Thermal,
}
TITLES = {"fleet": "handcal fleet", "fleet-recording": "handcal fleet, one recording",
          "lab-known-input": "handcal lab known-input --json"}  # fmt: skip


def schemas() -> dict[str, Schema]:
    """JSON Schema (draft 2020-12) of each kind of result, by the name of its command: those of
    ``explain --json`` are ``schemas()["explain"]``."""
    return {
        name: json_schema(name, TITLES.get(name, f"handcal {name.replace('-', ' ')} --json"), kind)
        for name, kind in RESULTS.items()
    }
