"""A motion written as a table in a random layout is read back as that motion."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from sample_recording import sample

from handcal.recordings.inputs import load
from handcal.types import InputError

N, RATE = 240, 100.0
DEG, G = np.pi / 180, 9.80665
# Of each sensor how its three columns may be called, %s being the axis (a capital one where %S).
NAMES = {
    "gyro": ("g%s", "w%s", "gyro_%s", "Gyro%S", "gyr %s", "GYRO_%S", "Gyroscope %S", "%sgyro",
             "angularVelocity%S", "rotation_rate_%s", "omega_%s", "imu.gyro.%s"),
    "accel": ("a%s", "acc_%s", "Acc%S", "accel-%s", "ACC_%S", "Accelerometer %S", "%sacc",
              "linear_acceleration_%s", "Accel %S axis", "imu.accel.%s"),
    "mag": ("m%s", "mag_%s", "Magnetometer %S", "magneticField%S", "%smag"),
}  # fmt: skip
UNITS = {
    "gyro": {"rad/s": 1.0, "deg/s": DEG, "dps": DEG, "°/s": DEG, "rad s^-1": 1.0, "mrad/s": 1e-3},
    "accel": {"m/s^2": 1.0, "g": G, "G": G, "mg": G / 1000, "m/s²": 1.0, "m/(s^2)": 1.0},
    "mag": {"uT": 1e-6, "µT": 1e-6, "gauss": 1e-4, "mG": 1e-7},
}
# As a last word of the name.
WORDS = {"gyro": {"dps": DEG, "rad_s": 1.0, "deg_s": DEG}, "mag": {"uT": 1e-6},
         "accel": {"g": G, "m_s2": 1.0, "mps2": 1.0, "mg": G / 1000}}  # fmt: skip
TIMES = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
START = datetime(2023, 12, 31, 23, 59, 59, 123456, tzinfo=UTC)
PREAMBLES = ("Device,AX-100", "# made by a logger", "Logging Type,0", "", "sep=;",
             "Notes: by hand; two", "Serial 1234567")  # fmt: skip


@dataclass(frozen=True)
class Layout:
    """How a motion is written."""

    sensors: tuple[str, ...]
    names: dict[str, str]
    units: dict[str, tuple[str, float]]
    place: str  # of the units: brackets, square, word, row, option
    separator: str
    comma: bool
    time: str
    preamble: tuple[str, ...]
    ending: str
    newline: str
    further: bool
    trailing: bool
    exponent: bool
    header: bool


@st.composite
def layouts(draw: st.DrawFn) -> Layout:
    place = draw(st.sampled_from(["brackets", "square", "word", "row", "option", "none"]))
    header = draw(st.booleans()) or draw(st.booleans()) or place not in ("option", "none")
    sensors = draw(st.permutations(["gyro", "accel", "mag"][: draw(st.integers(2, 3))]))
    table = {"word": WORDS, "none": {s: {"": 1.0} for s in NAMES}}.get(place, UNITS)
    # (a blank between columns is none within a name or a time)
    separators = ";,\t|" if header else ";,\t| "
    separator = draw(st.sampled_from(separators))
    times = [*TIMES, "clock", "iso", "date", "epoch ms", "epoch ns", "rate"]
    return Layout(
        tuple(sensors),
        {sensor: draw(st.sampled_from(NAMES[sensor])) for sensor in sensors},
        {sensor: draw(st.sampled_from(sorted(table[sensor].items()))) for sensor in sensors},
        place,
        separator,
        separator != "," and draw(st.booleans()),
        draw(st.sampled_from([time for time in times if separator != " " or time != "date"])),
        tuple(draw(st.lists(st.sampled_from(PREAMBLES), max_size=3))),
        draw(st.sampled_from([".csv", ".txt", ".tsv"])),
        draw(st.sampled_from(["\n", "\r\n"])),
        header and draw(st.booleans()),
        draw(st.booleans()),
        draw(st.booleans()),
        header,
    )


def moments(layout: Layout, t: np.ndarray) -> list[str]:
    """The column of times; [] where a rate is stated instead."""
    when = [START + timedelta(seconds=float(x)) for x in t]
    if layout.time == "clock":
        return [f"{w:%H:%M:%S.%f}" for w in when]
    if layout.time == "iso":
        return [w.isoformat(timespec="microseconds") for w in when]
    if layout.time == "date":
        return [f"{w:%d.%m.%Y %H:%M:%S.%f}" for w in when]
    if layout.time.startswith("epoch"):
        factor = TIMES[layout.time.split()[1]]
        return [str(round((w - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(microseconds=1))
                    * round(factor) // 10**6) for w in when]  # fmt: skip
    if layout.time == "rate":
        return []
    return [f"{x * TIMES[layout.time]:.3f}" for x in t]


def written(layout: Layout, t: np.ndarray, values: dict[str, np.ndarray]) -> str:
    """The whole text."""
    number = "{:.10e}" if layout.exponent else "{:.9f}"
    columns, names, units = [], [], []
    if stamps := moments(layout, t):
        columns, names, units = [stamps], ["Time"], [layout.time if layout.time in TIMES else ""]
        if layout.time in TIMES and layout.place not in ("row", "none"):
            names = [f"time_{layout.time}"]
    for sensor in layout.sensors:
        unit, factor = layout.units[sensor]
        for k, axis in enumerate("xyz"):
            name = layout.names[sensor].replace("%s", axis).replace("%S", axis.upper())
            around = {"brackets": " ({})", "square": " [{}]", "word": "_{}"}.get(layout.place, "")
            names.append(name + around.format(unit))
            units.append(unit)
            columns.append([number.format(x) for x in values[sensor][:, k] / factor])
    if layout.further:
        columns.append(["walking"] * len(t))
        names.append("activity")
        units.append("")
    if layout.comma:
        columns = [[cell.replace(".", ",") if cell[:1] in "-0123456789" and cell.count(".") == 1
                    else cell for cell in column] for column in columns]  # fmt: skip
    end = layout.separator if layout.trailing and layout.separator != " " else ""
    lines = list(layout.preamble)
    if layout.time == "rate":
        lines.append(f"Sample rate: {RATE:g} Hz")
    lines += [layout.separator.join(names)] if layout.header else []
    lines += [layout.separator.join(units)] if layout.place == "row" else []
    lines += [layout.separator.join(row) + end for row in zip(*columns, strict=True)]
    return layout.newline.join(lines) + layout.newline


def options(layout: Layout) -> dict[str, Any]:
    """What the file does not say."""
    said: dict[str, Any] = {}
    if layout.place == "option":
        said["units"] = {sensor: unit for sensor, (unit, _) in layout.units.items()}
    if not layout.header:
        axes = [f"{sensor[0]}{axis}" for sensor in layout.sensors for axis in "xyz"]
        said["columns"] = (*(["t"] if layout.time != "rate" else []), *axes)
    if layout.time in TIMES and (layout.place == "none" or not layout.header):
        said.setdefault("units", {})["time"] = layout.time
    return said


@settings(
    deadline=None, max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(layout=layouts())
def test_a_motion_in_any_layout_is_read_back(tmp_path: Path, layout: Layout) -> None:
    r = sample(n=N, streams=False).imu
    t = np.arange(N) / RATE
    mag = np.column_stack([20 + t, 5 - t, -40 + 2 * t]) * 1e-6
    path = tmp_path / f"a{layout.ending}"
    path.write_bytes(written(layout, t, {"gyro": r.gyro, "accel": r.accel, "mag": mag}).encode())
    event(f"{layout.time}, units in {layout.place}")
    back = load(path, **options(layout))
    # (thousandths of a second's unit; epoch ms has no more)
    np.testing.assert_allclose(back.imu.t, t, rtol=0, atol=1.1e-3 if "ms" in layout.time else 2e-6)
    np.testing.assert_allclose(back.imu.gyro, r.gyro, rtol=0, atol=1e-6)
    np.testing.assert_allclose(back.imu.accel, r.accel, rtol=0, atol=1e-6)
    if "mag" in layout.sensors:
        np.testing.assert_allclose(back.streams["mag"].value, mag, rtol=0, atol=1e-9)


MARKS = (",", ";", "\t", "\n", '"', "x", "1e308", "-", "nan", "12:00:00", "#", "()", "[0]", "/",
         "2024-13-45 12:00:00", "µ", "\0")  # fmt: skip


@settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    layout=layouts(),
    cuts=st.lists(
        st.tuples(st.floats(0, 1), st.integers(0, 9), st.sampled_from(MARKS)), max_size=9
    ),
    told=st.booleans(),
)
def test_damage_gives_a_recording_or_a_sentence(
    tmp_path: Path, layout: Layout, cuts: list[tuple[float, int, str]], told: bool
) -> None:
    """Most of it where the names and units are."""
    r = sample(n=60, streams=False).imu
    t = np.arange(60) / RATE
    text = written(layout, t, {"gyro": r.gyro, "accel": r.accel, "mag": 1e-5 * r.accel})
    for where, lost, mark in cuts:
        at = int(where**4 * len(text))
        text = text[:at] + mark + text[at + lost :]
    path = tmp_path / f"a{layout.ending}"
    path.write_text(text)
    with contextlib.suppress(InputError):
        load(path, **(options(layout) if told else {}))
