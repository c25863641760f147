"""Readings count once, and what is held out is unseen; options are for what is there."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner
from worlds import recording_of

from handcal.commands._app import app
from handcal.estimate.calibration import calibrate_together
from handcal.estimate.observed import BESIDE_HEADING
from handcal.explain import explain
from handcal.types import InputError, Recording
from handcal_sim import simulate, write
from handcal_sim.phone import consumer_phone


@pytest.fixture(scope="module")
def recording() -> Recording:
    return recording_of(simulate("three-turns", seed=0, duration_s=12.0), "heading")


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file with a heading and a magnetometer."""
    path = tmp_path_factory.mktemp("both") / "both.mcap"
    ran("simulate", "three-turns", "--seed", "0", "--duration", "12", "--mag", "-o", str(path))
    return path


def ran(*arguments: str, status: int = 0) -> str:
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == status, (done.output, done.exception)
    return done.stderr


def test_the_same_readings_do_not_count_twice(recording: Recording) -> None:
    again = replace(recording, path="copy.mcap")
    with pytest.raises(InputError, match=r"and copy\.mcap hold the same readings"):
        calibrate_together([recording, again])
    with pytest.raises(InputError, match="hold the same readings"):
        explain([recording, again])


def test_what_was_explained_is_not_held_out(recording: Recording) -> None:
    with pytest.raises(InputError, match=r"copy\.mcap, to be held out"):
        explain([recording], [replace(recording, path="copy.mcap")])


def test_a_magnetometer_beside_a_heading_is_said_to_be_unused(both: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.json"
    ran("calibrate", str(both), "--json", str(out))
    assert BESIDE_HEADING in json.loads(out.read_text(encoding="utf-8"))["warnings"]
    said = ran("calibrate", str(both), "--effects", "mag_hard_iron", status=2)
    assert "not used beside a heading" in said
    assert "--ignore" in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--height", "500"), "--height is ignored"),
        (("--reference-exact",), "--reference-exact is ignored"),
        (("--ignore", "heading", "--ignore", "mag", "--heading-sigma", "3"),
         "--heading-sigma is ignored"),
    ],
)  # fmt: skip
def test_options_for_what_is_not_there_are_said_to_be_left_aside(options, said, both: Path) -> None:
    quick = ("--effects", "gyro_scale", "--only")
    assert said in ran("calibrate", str(both), *quick, *options)


def test_options_for_what_is_there_are_not(both: Path) -> None:
    quick = ("--effects", "gyro_scale", "--only")
    assert "ignored" not in ran("calibrate", str(both), *quick, "--heading-sigma", "5")


def test_noise_is_not_found_in_no_time(both: Path) -> None:
    assert "at least 2 s" in ran("calibrate", str(both), "--noise-until", "0", status=2)


def test_of_what_little_was_told_is_said_where_it_is_taken_off(tmp_path: Path) -> None:
    world = simulate("z-turn", seed=1, duration_s=20.0, phone=consumer_phone)
    path, out = tmp_path / "z.mcap", tmp_path / "z.json"
    write(world, path)
    ran("calibrate", str(path), "--effects", "gyro_scale,accel_scale", "--json", str(out))
    hidden = [p["name"] for p in json.loads(out.read_text(encoding="utf-8"))["parameters"]
              if p["effect"] == "accel_scale" and not p["shown"]]  # fmt: skip
    assert hidden
    told = "accel_scale" if len(hidden) == 3 else f"accel_scale ({', '.join(hidden)})"
    said = ran("apply", str(path), "--from", str(out), "-o", str(tmp_path / "c.mcap"))
    assert told in said
    ran("export", str(out), "--to", "c", "-o", str(tmp_path / "c.h"))
    header = " ".join((tmp_path / "c.h").read_text(encoding="utf-8").replace("*", " ").split())
    assert told in header


def test_an_export_without_a_format_is_no_success(tmp_path: Path) -> None:
    said = ran("export", "x.json", "-o", str(tmp_path / "x.csv"), status=2)
    assert "--to FORMAT" in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--height", "500"), "--height needs --latitude"),
        (("--no-heading", "--heading-sigma", "3"), "--no-heading leaves nothing"),
        (("--perfect", "--device", "paper"), "give one of them"),
    ],
)
def test_simulated_devices_have_what_is_asked_for(options, said, tmp_path: Path) -> None:
    assert said in ran("simulate", "z-turn", "-o", str(tmp_path / "x.mcap"), *options, status=2)


def test_a_table_has_no_topics(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    rows = (f"{0.01 * k},0.1,{0.001 * (k % 7)},0,0,{0.01 * (k % 5)},9.8\n" for k in range(400))
    path.write_text("t,gx,gy,gz,ax,ay,az\n" + "".join(rows))
    assert "has no topics" in ran("info", str(path), "--topic", "imu=/imu", status=2)
