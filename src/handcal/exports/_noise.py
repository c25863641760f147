"""Noise of the IMU for programs that ask for it, and where each level is from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from handcal.documents import read_json
from handcal.exports import Format, Noise
from handcal.exports._text import one_line
from handcal.types import InputError

# Names in a result's ``noise``, and in Allan's ``suggested``, of what ``Noise`` has.
LEVELS = {"gyro_noise": "gyro_noise", "accel_noise": "accel_noise",
          "gyro_bias_walk_density": "gyro_bias_walk",
          "accel_bias_walk_density": "accel_bias_walk"}  # fmt: skip
ALLAN = ("gyro_noise", "accel_noise", "gyro_bias_walk", "accel_bias_walk")
# Coefficients of Allan's variance, and the level that each is of a sensor.
UNSEEN = {"N": "noise", "K": "bias_walk"}
MOVING = "of the moving device: inflated"
INFLATED = (
    "Warning: found while the device moved, and inflated (on a drone 18 and 6.6 times the data "
    "sheet's): {}. Better at rest: `handcal allan REST --json ALLAN.json`, then --noise ALLAN.json"
)
DEFAULT = "DEFAULT, not measured"
ASSUMED = (
    "Warning: not measured, but taken from the ADIS16448 of the EuRoC data set: {}. Measured in "
    "hours at rest: `handcal allan REST --json ALLAN.json`, then --noise ALLAN.json"
)


def noise_of(document: Mapping[str, Any], allan: Path | None, form: Format) -> Noise:
    """What the format holds: at rest, else of the motion, else its default. Errors: InputError."""
    if allan is None:
        rows = [*document.get("noise", [])]
        for r in document.get("recordings", [])[:1]:
            rows += r.get("noise", [])
        levels = _levels(rows, LEVELS, MOVING)
    else:
        levels = _of_allan(allan)
    for name, value in form.noise.items():
        if value is not None:
            levels.setdefault(name, (value, DEFAULT))
    return Noise(
        **{name: value for name, (value, _) in levels.items()},
        sources={name: source for name, (_, source) in levels.items()},
    )


def _of_allan(path: Path) -> dict[str, tuple[float, str]]:
    """Levels that were seen, and of the others the most that would have stayed hidden. Errors:
    InputError."""
    document = read_json(path)
    if not isinstance(document, dict) or document.get("schema") != "handcal/allan/1":
        raise InputError(f"{path} is not what `handcal allan --json` writes.")
    name = one_line(path.name)
    bounds: dict[str, float] = {}
    for channel in document.get("channels", []):
        sensor = str(channel.get("channel"))[:-2]
        for row in channel.get("not_seen", []):
            level, most = f"{sensor}_{UNSEEN.get(row.get('name'), '')}", row.get("at_most")
            if isinstance(most, (int, float)):
                bounds[level] = max(bounds.get(level, 0.0), most)
    rows = [{"name": level, "value": value} for level, value in bounds.items()]
    allan = {level: level for level in ALLAN}
    return {
        **_levels(rows, allan, f"at most, 95 %: not seen at rest ({name})"),
        **_levels(document.get("suggested", []), allan, f"at rest, {name}"),
    }


def _levels(
    rows: Sequence[Mapping[str, Any]], names: Mapping[str, str], source: str
) -> dict[str, tuple[float, str]]:
    """Levels larger than zero by their names in ``Noise``, each with its source."""
    return {
        names[r["name"]]: (float(r["value"]), source)
        for r in rows
        if r.get("name") in names and isinstance(r.get("value"), (int, float)) and r["value"] > 0
    }


def noise_lines(noise: Noise, form: Format) -> list[str]:
    """What there is to doubt about the levels that the format holds."""
    out = []
    for source, sentence in ((MOVING, INFLATED), (DEFAULT, ASSUMED)):
        names = [name for name in form.noise if noise.sources.get(name) == source]
        if names:
            out.append(sentence.format(", ".join(names)))
    return out
