"""Noise of the IMU for programs that ask for it, and where each level is from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from handcal.documents import read_json
from handcal.exports import Format, Noise
from handcal.exports._known import recordings_of
from handcal.exports._text import one_line
from handcal.types import InputError

# Names in a result's ``noise``, and in Allan's ``suggested``, of what ``Noise`` has.
LEVELS = {"gyro_noise": "gyro_noise", "accel_noise": "accel_noise",
          "gyro_bias_walk_density": "gyro_bias_walk",
          "accel_bias_walk_density": "accel_bias_walk"}  # fmt: skip
ALLAN = ("gyro_noise", "accel_noise", "gyro_bias_walk", "accel_bias_walk")
WHITE = ("gyro_noise", "accel_noise")
# Coefficients of Allan's variance, and the level that each is of a sensor.
UNSEEN = {"N": "noise", "K": "bias_walk"}
# Times the noise of a rest above which a fit counted motion as noise.
MOVED = 1.5
FIT = "of the fit"
AT_REST, NO_REST = f"{FIT}, about that of its rest", f"{FIT}, to a recording without a rest"
INFLATED = (
    "Warning: noise of the fit, which holds what it does not follow of the motion: {}. Better at "
    "rest: `handcal allan REST --json ALLAN.json`, then --noise ALLAN.json"
)
DEFAULT = "DEFAULT, not measured"
ASSUMED = (
    "Warning: not measured, but taken from the ADIS16448 of the EuRoC data set: {}. Measured in "
    "hours at rest: `handcal allan REST --json ALLAN.json`, then --noise ALLAN.json"
)


def noise_of(document: Mapping[str, Any], allan: Path | None, form: Format) -> Noise:
    """What the format holds: at rest, else of the fit, else its default. Errors: InputError."""
    levels = _of_fit(document) if allan is None else _of_allan(allan)
    for name, value in form.noise.items():
        if value is not None:
            levels.setdefault(name, (value, DEFAULT))
    return Noise(
        **{name: value for name, (value, _) in levels.items()},
        sources={name: source for name, (_, source) in levels.items()},
    )


def _of_fit(document: Mapping[str, Any]) -> dict[str, tuple[float, str]]:
    """Levels of the result's fit, each beside what the recording's longest rest shows."""
    rows = [*document.get("noise", [])]
    for r in document.get("recordings", [])[:1]:
        rows += r.get("noise", [])
    found = _levels(rows, LEVELS, FIT)
    rests = [r["rest_noise"] for r in recordings_of(document) if "rest_noise" in r]
    for name in found.keys() & WHITE if rests else ():
        value, rest = found[name][0], _number(rests[0], name)
        times = value / rest if rest else 0.0
        beside = f"{FIT}, {times:.2g} times that of its rest" if rest else NO_REST
        found[name] = value, AT_REST if 0.0 < times <= MOVED else beside
    return found


def _number(levels: Any, name: str) -> float:
    """A level larger than zero; 0 where there is none."""
    value = levels.get(name) if isinstance(levels, Mapping) else None
    return float(value) if isinstance(value, (int, float)) and value > 0 else 0.0


def allan_document(path: Path) -> Mapping[str, Any]:
    """What ``handcal allan --json`` wrote. Errors: InputError."""
    document = read_json(path)
    if not is_allan(document):
        raise InputError(f"{path} is not what `handcal allan --json` writes.")
    return cast(Mapping[str, Any], document)


def is_allan(document: Any) -> bool:
    return isinstance(document, Mapping) and document.get("schema") == "handcal/allan/1"


def _of_allan(path: Path) -> dict[str, tuple[float, str]]:
    """Levels that were seen, and of the others the most that would have stayed hidden. Errors:
    InputError."""
    document = allan_document(path)
    of = ", ".join(Path(str(r["path"])).name for r in recordings_of(document))
    name = one_line(f"{path.name} of {of}" if of else path.name)
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
    out, sources = [], {name: noise.sources.get(name, "") for name in form.noise}
    moved = [name + source.replace(FIT, "").replace(", ", " (") + ")" * (source != FIT)
             for name, source in sources.items()
             if source.startswith(FIT) and source != AT_REST]  # fmt: skip
    if moved:
        out.append(INFLATED.format(", ".join(moved)))
    if assumed := [name for name, source in sources.items() if source == DEFAULT]:
        out.append(ASSUMED.format(", ".join(assumed)))
    return out
