"""Tables as people have them: many layouts of one motion, what a refusal says to type, and the
options that say what a file does not."""

from __future__ import annotations

import io
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from lab_world import command
from sample_recording import sample
from typer.testing import CliRunner

import handcal
from handcal.commands import _options
from handcal.commands._app import app
from handcal.recordings.export import write_mcap
from handcal.recordings.inputs import load
from handcal.recordings.inputs._names import Producer, vocabulary
from handcal.types import InputError, Recording
from handcal_sim import simulate

DEG, G = np.pi / 180, 9.80665
LAYOUTS = (
    "clock_time.csv", "core_motion.csv", "rostopic_echo_p.csv", "ulog2csv.csv",
    "unit_in_name.csv", "units_row.csv",
)  # fmt: skip
TOLD = {"no_header.csv", "one_matrix.mat", "preamble_counts_no_time.csv"}
OPTION = re.compile(r"(--(?:columns|units|rate) [^\s]+?)(?=\.?(?:\s|$))")


def typed(refused: str) -> dict[str, object]:
    """The options that a refusal says to give, as ``load`` takes them."""
    words = shlex.split(" ".join(OPTION.findall(refused)))
    given = dict(zip(words[::2], words[1::2], strict=True))
    how = _options.Reading(units=given.get("--units"), columns=given.get("--columns"))
    return {name: value for name, value in how.said.items() if value}


def read_as_told(path: Path) -> Recording:
    """A recording of a file that is refused, with what the refusal says to give."""
    with pytest.raises(InputError) as refused:
        load(path)
    return load(path, **typed(str(refused.value)))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", [*LAYOUTS, *sorted(TOLD)])
def test_one_motion_in_many_layouts_is_one_recording(cases: Path, name: str) -> None:
    path = cases / "tables" / name
    got = read_as_told(path) if name in TOLD else load(path)
    expected = load(cases / "tables" / "units_row.csv").imu
    np.testing.assert_allclose(got.imu.t, expected.t, rtol=0, atol=1e-9)
    # (half of the last digit that a layout has: 0.01 deg/s, a count, 0.0001 g)
    np.testing.assert_allclose(got.imu.gyro, expected.gyro, rtol=0, atol=0.0056 * DEG)
    np.testing.assert_allclose(got.imu.accel, expected.accel, rtol=0, atol=1.1e-3)


def test_every_layout_is_tried(cases: Path) -> None:
    assert {p.name for p in (cases / "tables").iterdir()} == {*LAYOUTS, *TOLD}


def test_counts_are_read_as_the_refusal_says(cases: Path) -> None:
    """A real file, beside its numbers in g and deg/s."""
    back, known = read_as_told(cases / "counts_real.csv"), load(cases / "ten_rests_real.csv")
    assert back.rate_hz == pytest.approx(100.0)
    rest = [np.linalg.norm(r.imu.accel[:50].mean(axis=0)) for r in (back, known)]
    assert rest[0] == pytest.approx(rest[1], rel=0.02)


def test_time_that_counts_samples_asks_for_the_rate(cases: Path) -> None:
    with pytest.raises(InputError, match=r"time counts samples.*--rate HZ"):
        load(cases / "index_as_time.csv")
    assert load(cases / "index_as_time.csv", rate_hz=50.0).duration_s == pytest.approx(4799 / 50)


def columns_of(r: Recording) -> np.ndarray:
    return np.column_stack([r.imu.t, r.imu.gyro, r.imu.accel])


def text(header: str, table: np.ndarray, separator: str = ",", digits: str = "%.9f") -> str:
    out = io.StringIO()
    np.savetxt(out, table, fmt=digits, delimiter=separator)
    return f"{header}\n{out.getvalue()}" if header else out.getvalue()


def even(n: int = 400) -> Recording:
    """On a clock without jitter, so that a rate is all of it."""
    r = sample(n=n, streams=False)
    t = np.arange(n) / 100.0
    return Recording("even", type(r.imu)(t, r.imu.gyro, r.imu.accel, r.imu.valid), {}, 0)


def check_same(got: Recording, expected: Recording, atol: float = 1e-6) -> None:
    np.testing.assert_allclose(got.imu.t, expected.imu.t, rtol=0, atol=1e-6)
    np.testing.assert_allclose(got.imu.gyro, expected.imu.gyro, rtol=0, atol=atol)
    np.testing.assert_allclose(got.imu.accel, expected.imu.accel, rtol=0, atol=atol)


@pytest.mark.parametrize("ending", [".csv", ".txt", ".npy", ".mat"])
def test_a_plain_matrix_is_read_as_the_refusal_says(tmp_path: Path, ending: str) -> None:
    expected, path = even(), tmp_path / f"a{ending}"
    table = columns_of(expected)[:, [0, 4, 5, 6, 1, 2, 3]]
    if ending == ".npy":
        np.save(path, table)
    elif ending == ".mat":
        from scipy.io import savemat

        savemat(path, {"log": table})
    else:
        path.write_text(text("", table))
    check_same(read_as_told(path), expected)


def test_of_what_is_unknown_the_rest_is_filled_in(tmp_path: Path) -> None:
    """A sensor between the two, and nothing turns: what the numbers tell, and what they do not."""
    rng = np.random.default_rng(0)
    still = rng.normal([0, 0, 0, 20, 5, -40, 0, 0, 9.81], 1e-3, (400, 9))
    path = tmp_path / "a.csv"
    path.write_text(text("", np.column_stack([np.arange(400) / 100, still])))
    with pytest.raises(InputError, match=re.escape("--columns t,?,?,?,?,?,?,ax,ay,az")):
        load(path)


def test_units_are_proposed_of_times_by_the_clock_too(tmp_path: Path) -> None:
    world = simulate("free-hand", seed=0, duration_s=30.0)
    t, read = world.imu.stamps, world.imu.values / [*[DEG] * 3, *[G] * 3]
    moments = np.datetime64("2026-01-01T00:00:00") + np.round(1e6 * t).astype("timedelta64[us]")
    lines = [f"{m}Z," + ",".join(f"{x:.6f}" for x in row)
             for m, row in zip(moments, read, strict=True)]  # fmt: skip
    path = tmp_path / "clock.csv"
    path.write_text("\n".join(["timestamp,gx,gy,gz,ax,ay,az", *lines]))
    with pytest.raises(InputError, match="give --units accel=g,gyro=deg/s"):
        load(path)


def test_all_that_is_wrong_is_said_at_once(tmp_path: Path) -> None:
    """No time, counts, and nothing states the unit."""
    r = even()
    table = np.column_stack([r.imu.gyro / DEG * 65.5, r.imu.accel / G * 8192])
    path = tmp_path / "a.csv"
    path.write_text(text("gx,gy,gz,ax,ay,az", table, digits="%.0f"))
    with pytest.raises(InputError, match=r"time.*its unit is not stated") as refused:
        load(path)
    assert "--rate HZ" in str(refused.value)
    assert "accel=g/8192" in str(refused.value)
    with pytest.raises(InputError, match=re.escape("--units accel=g/8192,gyro=deg/s/65.5")):
        load(path, rate_hz=100.0)
    back = load(path, rate_hz=100.0, units={"accel": "g/8192", "gyro": "deg/s/65.5"})
    check_same(back, r, atol=2e-3)


def clock(t: np.ndarray) -> list[str]:
    return [f"00:{int(x // 60):02d}:{x % 60:09.6f}" for x in t]


def counts(t: np.ndarray, second: float) -> list[str]:
    """Times as whole numbers, after some minutes."""
    return [str(round((1000.0 + x) * second)) for x in t]


def written_by(producer: str, r: Recording) -> list[object]:
    """The columns of a motion as a program writes them, in the order of its header."""
    t, w, f = r.imu.t, r.imu.gyro, r.imu.accel
    none, mag = np.zeros(len(t)), np.tile([20.0, 5.0, -40.0], (len(t), 1))
    frd = np.array([1.0, -1.0, -1.0])
    if producer.startswith("rostopic"):
        return [counts(t + 0.003, 1e9), none, counts(t, 1e9), ["imu"] * len(t), *w.T, *f.T]
    if producer.startswith("Kalibr"):
        return [counts(t, 1e9), *w.T, *f.T]
    if producer.startswith("ulog2csv"):
        return [counts(t, 1e6), *(w * frd).T, none, none, *(f * frd).T]
    if producer.endswith("ArduPilot, IMU"):
        return [t + 1.7e9, counts(t, 1e6), none, *(w * frd).T, *(f * frd).T, *[none] * 6]
    if producer.endswith("HIGHRES_IMU"):
        units = (f * frd, w * frd, mag * frd / 100)
        return [t + 1.7e9, counts(t, 1e6), *(axis for some in units for axis in some.T), none]
    if producer.startswith("mavlogdump"):
        units = (f * frd / G * 1000, w * frd * 1000, mag * frd * 10)
        second = 1e3 if "SCALED" in producer else 1e6
        return [t + 1.7e9, counts(t, second), *(axis for some in units for axis in some.T)]
    if producer.endswith("the raw accelerometer"):
        return [t, *(-f / G).T, *w.T]
    if producer.startswith("bagpy"):
        sec = np.floor(t).astype(int)
        return [t + 0.004, none, 1_700_000_000 + sec, np.rint((t - sec) * 1e9).astype(int),
                ["imu"] * len(t), *w.T, *f.T]  # fmt: skip
    if producer == "WitMotion":
        when = [f"2023-5-6 {one}" for one in clock(t)]
        return [when, ["WT901"] * len(t), when, *(f / G).T, *(w / DEG).T, none, none, none, none]
    if producer.startswith("EuRoC"):
        return [counts(t, 1e9), *w.T, *f.T]
    if producer == "Apple CoreMotion":
        return [t, *(-0.9 * f / G).T, *(-0.1 * f / G).T, *w.T]
    if producer == "SensorLog of iOS":
        return [clock(t), t, *w.T, *(-0.1 * f / G).T, *(-0.9 * f / G).T]
    if producer == "SparkFun OpenLog Artemis":
        day = ["08/10/2020"] * len(t)
        return [day, clock(t), *(f / G * 1000).T, *(w / DEG).T, *mag.T, none + 25, none + 100,
                [""] * len(t)]  # fmt: skip
    if producer.startswith("Physics"):
        return [t, *(f / G).T, *w.T, *mag.T]
    if producer.startswith("Axivity"):
        return [[f"2020-08-10 {one}" for one in clock(t)], *(f / G).T, *(w / DEG).T]
    if producer == "AndroSensor":
        return [*f.T, *(0.9 * f).T, *(0.1 * f).T, *w.T, *mag.T, counts(t, 1e3)]
    if producer.startswith("Arduino"):
        return [counts(t, 1e3), *(f / G).T, *(w / DEG).T]
    assert producer == "Shimmer"
    return [counts(t, 1e3), *f.T, *(w / DEG).T]


@pytest.mark.parametrize("producer", vocabulary().producers, ids=lambda p: p.name)
def test_what_a_program_writes_is_read(tmp_path: Path, producer: Producer) -> None:
    expected, path = even(), tmp_path / "a.csv"
    separator = next(mark for mark in "\t;," if mark in producer.header)
    columns = [[str(x) for x in one] for one in written_by(producer.name, expected)]
    rows = [separator.join(row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([producer.header, *rows]) + "\n")
    back = load(path)
    check_same(back, expected)
    if "mag" in back.streams:
        np.testing.assert_allclose(back.streams["mag"].value[0], [20e-6, 5e-6, -40e-6])


def test_of_several_sensors_the_first_is_read(tmp_path: Path) -> None:
    expected, path = even(), tmp_path / "a.csv"
    producer = next(p for p in vocabulary().producers if p.one_of)
    columns = [[str(x) for x in one] for one in written_by(producer.name, expected)]
    rows = []
    for row in zip(*columns, strict=True):
        rows += [",".join(row), ",".join([*row[:2], "1", *row[3:5], "7.0", *row[6:]])]
    path.write_text("\n".join([producer.header, *rows]) + "\n")
    back = load(path)
    check_same(back, expected)
    assert any("Of 2 sensors" in said for said in back.warnings)


TURNED = {"mag": "y,x,-z"}


def with_mag(path: Path) -> Path:
    r = even()
    mag = np.column_stack([20 + r.imu.t, 5 - r.imu.t, -40 + 2 * r.imu.t])
    header = "t,gx,gy,gz,ax,ay,az,mx (uT),my (uT),mz (uT)"
    path.write_text(text(header, np.column_stack([columns_of(r), mag])))
    return path


def test_axes_are_a_signed_exchange_of_a_sensors(tmp_path: Path) -> None:
    path = with_mag(tmp_path / "a.csv")
    plain = load(path).streams["mag"].value
    np.testing.assert_array_equal(
        load(path, axes=TURNED).streams["mag"].value, plain[:, [1, 0, 2]] * [1, 1, -1]
    )
    both = {"gyro": "-y,x,z", "accel": "-y,x,z"}
    r, turned = even().imu, load(path, axes=both).imu
    np.testing.assert_allclose(turned.gyro, r.gyro[:, [1, 0, 2]] * [-1, 1, 1], atol=1e-8)
    np.testing.assert_allclose(turned.accel, r.accel[:, [1, 0, 2]] * [-1, 1, 1], atol=1e-8)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"axes": {"mag": "x,y,y"}}, "mag=y,x,-z"),
        ({"axes": {"mag": "x,y"}}, "mag=y,x,-z"),
        ({"axes": {"nose": "x,y,z"}}, "gyro, accel, mag"),
        ({"rate_hz": 0.0}, "--rate 0"),
        ({"rate_hz": float("nan")}, "--rate nan"),
        ({"columns": ("t", "gxx")}, r"'gxx' is no column. Did you mean gx"),
        ({"columns": ("t",) * 11}, "names 11 columns, and there are 10"),
        ({"units": {"accel": "g/0"}}, "--units accel=g/0"),
        ({"units": {"accel": "16384"}}, "--units accel=16384"),
        ({"columns": ("t", "gx", "gy", "gz")}, "lacks columns for accel x, accel y, accel z"),
    ],
)
def test_options_that_say_nothing(tmp_path: Path, options: dict[str, object], match: str) -> None:
    with pytest.raises(InputError, match=match):
        load(with_mag(tmp_path / "a.csv"), **options)  # type: ignore[arg-type]


def test_a_file_that_knows_its_columns_takes_no_others(tmp_path: Path) -> None:
    write_mcap(even(), tmp_path / "a.mcap")
    with pytest.raises(InputError, match="--columns and --rate are for tables"):
        load(tmp_path / "a.mcap", rate_hz=100.0)
    without = load(tmp_path / "a.mcap", axes={"gyro": "y,-x,z", "accel": "y,-x,z"})
    np.testing.assert_array_equal(without.imu.gyro[:, 0], even().imu.gyro[:, 1])
    with pytest.raises(InputError, match="has no magnetometer"):
        load(tmp_path / "a.mcap", axes=TURNED)


COMMANDS = ["info", "calibrate", "explain", "allan", "replay", "apply", "conceal", "import",
            "export", "live", "design motion", "lab scalar", "lab known-input", "lab size",
            "lab thermal"]  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_that_reads_a_recording_has_the_options(command: str) -> None:
    said = run(*command.split(), "--help").stdout
    for option in ("--units", "--columns", "--rate", "--axes", "--topic"):
        assert option in said


def run(*words: object) -> Result:
    return CliRunner().invoke(app, [str(w) for w in words], env={"COLUMNS": "200"})


def counted_table(path: Path) -> Path:
    """Counts without a name, a unit or a time."""
    r = even()
    table = np.column_stack([r.imu.gyro / DEG * 131, r.imu.accel / G * 16384])
    path.write_text(text("", table, digits="%.0f"))
    return path


def test_import_takes_them_and_so_does_handcal_toml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = counted_table(tmp_path / "a.txt"), tmp_path / "a.mcap"
    units = "accel=g/16384,gyro=deg/s/131"
    words = ["--columns", "gx,gy,gz,ax,ay,az", "--rate", 100, "--units", units]
    done = run("import", path, *words, "--axes", "gyro=y,-x,z", "--axes", "accel=y,-x,z", "-o", out)
    assert done.exit_code == 0, done.stderr
    back = load(out)
    np.testing.assert_allclose(back.imu.gyro[:, 0], even().imu.gyro[:, 1], rtol=0, atol=1e-4)
    config = tmp_path / "handcal.toml"
    config.write_text(
        f'[info]\ncolumns = "gx,gy,gz,ax,ay,az"\nrate = 100\nunits = "{units}"\n'
        'axes = ["gyro=y,-x,z", "accel=y,-x,z"]\n'
    )
    status, said, err = command(
        monkeypatch, capsys, "info", path, "--config", config, "--json", "-"
    )
    assert status == 0, err
    assert json.loads(said)["recording"]["duration_s"] == pytest.approx(3.99)


def test_explain_repeats_them_in_the_commands_that_come_next() -> None:
    how = _options.Reading(columns="t,gx", rate=50.0, axes=["mag=y,x,-z"], units="accel=g/16384")
    assert shlex.join(how.typed) == (
        "--units accel=g/16384 --columns t,gx --rate 50.0 --axes mag=y,x,-z"
    )


def test_python_has_the_options_and_says_them_in_its_words(tmp_path: Path) -> None:
    path = counted_table(tmp_path / "a.txt")
    with pytest.raises(InputError) as refused:
        handcal.read(path, rate_hz=100.0)
    said = str(refused.value)
    assert 'columns="gx,gy,gz,ax,ay,az"' in said
    assert 'units={"accel": "g/16384", "gyro": "deg/s/131"}' in said
    assert "--" not in said
    back = handcal.read(path, columns="gx,gy,gz,ax,ay,az", rate_hz=100.0,
                        units={"accel": "g/16384", "gyro": "deg/s/131"})  # fmt: skip
    assert back.rate_hz == pytest.approx(100.0)


def test_a_name_that_is_of_another_language_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text("Zeit;gx;gy;gz;ax;ay;az", columns_of(even()), ";"))
    with pytest.raises(InputError, match=r"lacks columns for time .*'Zeit'"):
        load(path)
    check_same(read_as_told(path), even())


def test_commas_of_two_kinds_are_said_to_be(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text("t,gx,gy,gz,ax,ay,az", columns_of(even()), ";").replace(".", ","))
    path.write_text(path.read_text().replace(";", ","))
    with pytest.raises(InputError, match="Export it with semicolons"):
        load(path)


def test_numbers_of_any_writing(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text("t,gx,gy,gz,ax,ay,az", columns_of(even()), digits="%+.9E"))
    check_same(load(path), even())


@pytest.mark.parametrize(
    "upper", ["Time,Gyroscope,,,Accelerometer,,", "Time,Gyr,Gyr,Gyr,Acc,Acc,Acc"]
)
def test_a_sensor_may_stand_above_its_axes(tmp_path: Path, upper: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text(f"{upper}\nTime,X,Y,Z,X,Y,Z", columns_of(even())))
    check_same(load(path), even())


def test_rows_may_be_labelled(tmp_path: Path) -> None:
    """As a sketch prints them for the serial plotter; what it says between them is no row."""
    names, table = ("t", "gx", "gy", "gz", "ax", "ay", "az"), columns_of(even())
    rows = [" ".join(f"{n}:{x:.9f}," for n, x in zip(names, row, strict=True)) for row in table]
    path = tmp_path / "a.txt"
    path.write_text("\n".join(["MPU6050 found", *rows]) + "\n")
    check_same(load(path), even())
