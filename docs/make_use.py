"""Writes docs/use/: a page for each export, with one worked sensor; `make docs` runs it."""

from __future__ import annotations

import ast
import importlib.util
import json
import tempfile
from pathlib import Path

import numpy as np

import handcal
from handcal.effects import catalogue
from handcal.exports import Format, formats
from handcal.exports._contents import contents

VERSION = "0.1.0"  # that the pages show, so that no commit changes them
FOLDER = Path(__file__).resolve().parent / "use"

# The worked sensor: each error in the one place where its sign shows.
SENSOR = {
    "gyro_bias": [0.01, 0.0, -0.02],
    "accel_bias": [0.1, 0.0, 0.3],
    "gyro_scale": [0.02, 0.0, 0.0],
    "gyro_misalignment": [0.01, 0.0, 0.0, 0.0, 0.0, 0.0],
    "accel_scale": [0.0, 0.0, 0.01],
    "accel_misalignment": [0.005, 0.0, 0.0],
}
# Raw readings of a PX4 without offsets; and what ArduPilot corrected by no calibration at all.
VEHICLE = {"CAL_GYRO0_ID": 1, "CAL_ACC0_ID": 1, "sensor_gyro.device_id": 1,
           "sensor_accel.device_id": 1,
           **{f"CAL_{sensor}0_{a}{name}": float(name == "SCALE") for a in "XYZ"
              for sensor in ("GYRO", "ACC") for name in ("OFF", "SCALE")},
           **{f"INS_{name}_{a}": float(name == "ACCSCAL") for a in "XYZ"
              for name in ("GYROFFS", "ACCOFFS", "ACCSCAL")}}  # fmt: skip
READ = ((1.03, 0.0, -0.02), (0.1, 0.0, 10.2047165))  # 1 rad/s about x, at rest on its back
PAGE = """# Use the result in {program}

*How-to.* Type `handcal export RESULT.json --to {name} -o {file}`.

{text}{raw}

## A worked sensor

Its gyro reads 0.01 rad/s too much about x and 0.02 too little about z, every turn about x 2 % too large, and about x 1 % of what it turns about y. Its accelerometer reads 0.1 m/s² too much along x and 0.3 along z, 1 % too much along z, and along y 0.5 % of what it feels along x. It turns about x with 1 rad/s while z points up: it reads ({w}) rad/s and ({a}) m/s².{corrected}

```{language}
{written}```
"""  # noqa: E501
RAW = """

The numbers are for raw readings, not for a recording that `handcal apply` wrote."""
FILES = {"kalibr": "imu.yaml", "openvins": "kalibr_imu_chain.yaml",
         "openvins_rpng": "kalibr_imu_chain.yaml", "fusion": "calibration.h",
         "imucal": "ferraris.json", "px4": "handcal.params", "ardupilot": "handcal.param",
         "realsense": "calibration.json", "ros2": "covariances.yaml", "python": "correct.py",
         "c": "correct.h", "csv": "parameters.csv", "latex": "parameters.tex",
         "markdown": "parameters.md"}  # fmt: skip
LANGUAGES = {"yaml": "yaml", "h": "c", "json": "json", "py": "python", "tex": "latex"}


def document() -> dict[str, object]:
    """What ``calibrate --json`` would have written of the sensor."""
    parameters = [
        {"effect": i, "name": p.name, "value": v, "sigma": p.prior_sigma / 50.0, "unit": p.unit,
         "observable": True}
        for i, values in SENSOR.items()
        for p, v in zip(catalogue()[i].parameters, values, strict=True)
    ]  # fmt: skip
    return {
        "schema": "handcal/calibration/1",
        "version": handcal.__version__,
        "recording": {
            "path": "turns.mcap",
            "duration_s": 84.0,
            "imu_rate_hz": 100.0,
            "vehicle": VEHICLE,
        },
        "parameters": parameters,
        "noise": [{"name": "gyro_noise", "value": 1.5e-4}, {"name": "accel_noise", "value": 2e-3}],
    }


def _docstring(name: str) -> str:
    spec = importlib.util.find_spec(f"handcal.exports.{name}")
    assert spec is not None
    assert spec.origin is not None
    source = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    return (ast.get_docstring(source) or "").replace("``", "`")


def _page(name: str, form: Format, result: Path) -> str:
    made = contents(result, form)
    corrected = ""
    if form.keep is not None:
        bias = np.zeros(6) if not form.online else made.bias
        found = made.correction.applied((np.hstack(READ) - bias)[None])[0] + 0.0
        w, a = (", ".join(f"{v:.4g}" for v in np.round(x, 6) + 0.0) for x in (found[:3], found[3:]))
        less = " (and the biases that the program finds)" if form.online else ""
        corrected = f" With this file{less}, that becomes ({w}) and ({a})."
    w, a = (", ".join(f"{v:.4f}".rstrip("0").rstrip(".") for v in x) for x in READ)
    file = FILES.get(name, f"calibration.{name}")
    return PAGE.format(
        raw="" if form.vehicle else RAW,
        program=form.program, name=name, file=file, text=_docstring(name), w=w, a=a,
        corrected=corrected, language=LANGUAGES.get(Path(file).suffix[1:], ""),
        written=form.write(made).replace(f"handcal {handcal.__version__}", f"handcal {VERSION}"),
    )  # fmt: skip


def pages() -> dict[str, str]:
    """Every page by the name of its file."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        result.write_text(json.dumps(document()), encoding="utf-8")
        return {f"{name}.md": _page(name, form, result) for name, form in formats().items()}


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for file, text in pages().items():
        (FOLDER / file).write_text(text, encoding="utf-8")
