"""The wrong readings of tests/test_hostile_signals.py in the laboratory's methods, in
`design motion --after`, `live --from`, `fleet`: said and right within the sigmas, or refused."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from lab_world import TRUTH, command, recording
from test_hostile_signals import DOUBTFUL, REFUSED, Attack
from test_lab_size import FACE_DIAGONALS, Device, on_a_table

import handcal
from handcal.lab import known_input, size, steady_tests
from handcal.lab.sound import doubts, refuse_dead, refuse_incredible
from handcal.lab.thermal.curves import thermal
from handcal.recordings.export import write_mcap
from handcal.recordings.inputs import of_arrays
from handcal.types import HandcalError, Imu, Recording, Series
from handcal_sim import simulate, write

ATTACKS: dict[str, Attack] = {k: attack for k, (attack, _) in REFUSED.items()} | DOUBTFUL
ATTACKS["gyro at the end of its range, by a tenth"] = lambda t, g, a: (
    t, np.clip(g, -0.9 * np.abs(g).max(), 0.9 * np.abs(g).max()), a)  # fmt: skip
# Standard errors beyond which a number is wrong for sure (of some ten numbers a recording).
SURELY = 4.5
# A number that is said to be doubtful beside another: nothing fits as it should.
SAID = "something else is wrong"


def known_inputs(of: Recording) -> tuple[Iterator[float], tuple[str, ...]]:
    found = known_input.known_input(steady_tests.of_recording(of))
    off = ((p.value - TRUTH[p.effect, p.name]) / p.sigma
           for p in found.parameters if (p.effect, p.name) in TRUTH)  # fmt: skip
    return off, found.warnings


def sizes(of: Recording) -> tuple[Iterator[float], tuple[str, ...]]:
    found = size.size(of)
    return iter(((found.arms - Device(1).places) / found.arm_sigma).ravel()), found.warnings


def curves(of: Recording) -> tuple[Iterator[float], tuple[str, ...]]:
    found = thermal([of])
    off = []
    for c in found.curves:
        value, sigma = c.at(np.linspace(*found.span, 9))
        true = TRUTH[c.effect, c.name] if c.anchored else 0.0
        off.append(float((np.abs(value - true) / np.maximum(sigma, 1e-12)).max()))
    return iter(off), found.warnings


Solved = tuple[Iterator[float], tuple[str, ...]]
METHODS: dict[str, tuple[Callable[[], Recording], Callable[[Recording], Solved]]] = {
    "known-input": (lambda: recording("steady-spins", seed=1), known_inputs),
    "size": (lambda: on_a_table(Device(1), FACE_DIAGONALS, (200.0,), 1e-3), sizes),
    "thermal": (lambda: recording("soak", seed=1), curves),
}


@pytest.fixture(scope="module")
def worlds() -> Callable[[str], Recording]:
    kept: dict[str, Recording] = {}

    def world(name: str) -> Recording:
        if name not in kept:
            kept[name] = METHODS[name][0]()
        return kept[name]

    return world


def attacked(of: Recording, attack: Attack, together: bool) -> Recording:
    """together: a jump of the IMU's clock is one of all streams; else it jumps beside them."""
    t, gyro, accel = attack(of.imu.t, of.imu.gyro, of.imu.accel)
    jump = float(t[-1] - of.imu.t[-1]) if together and len(t) == len(of.imu.t) else 0.0
    half = of.imu.t[len(of.imu.t) // 2]
    streams = {n: ((s.t + np.where(s.t < half, 0.0, jump), s.value), s.value.shape[1])
               for n, s in of.streams.items()}  # fmt: skip
    return of_arrays("x", t, gyro, accel, streams)


@pytest.mark.prove
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["as it is", *ATTACKS])
def test_no_laboratory_method_gives_a_confident_wrong_number(
    worlds: Callable[[str], Recording], method: str, name: str
) -> None:
    """A clock that jumps by a ms beside a table is no harm; by a second it is."""
    world, solve = worlds(method), METHODS[method][1]
    refused = 0
    for together in (True, False):
        try:
            off, said = solve(attacked(world, ATTACKS.get(name, lambda *x: x), together))
        except HandcalError:
            refused += 1
            continue
        assert SAID in " ".join(said) or max(map(abs, off)) < SURELY
    assert refused == 0 or name != "as it is"


def test_a_dead_axis_and_one_that_hardly_reads_are_refused() -> None:
    """Whatever the method: on a table in six spins."""
    sound = on_a_table(Device(1), FACE_DIAGONALS, (200.0,), 1e-3)
    refuse_dead(sound)
    for k in range(3):
        dead = sound.imu.accel * (np.arange(3) != k)
        with pytest.raises(HandcalError, match=f"accelerometer's {'xyz'[k]} never moves"):
            size.size(replace(sound, imu=replace(sound.imu, accel=dead)))
    # an ideal device at rest moves by no bit on any axis
    n = 100
    still = Imu(np.arange(n) / 50.0, np.zeros((n, 3)), np.ones((n, 3)), np.ones(n, dtype=np.bool_))
    refuse_dead(Recording("still", still, {}))
    refuse_incredible([("gyro_scale", "x", 0.1), ("gyro_bias", "x", -1.0)])
    with pytest.raises(HandcalError, match=r"gyroscope's x reads 0\.0175 times"):
        refuse_incredible([("gyro_scale", "x", np.radians(1.0) - 1.0)])


def test_what_fits_badly_is_said_and_what_does_not_fit_is_refused() -> None:
    assert doubts({"gyro": 1e-3, "accel": 0.05}) == ()
    (said,) = doubts({"gyro": 0.03, "accel": 0.05})
    assert SAID in said
    assert "1.7 deg/s" in said
    with pytest.raises(HandcalError, match="nothing fits"):
        doubts({"gyro": 0.0, "accel": 1.0})


def test_a_reference_of_another_clock_is_refused(worlds: Callable[[str], Recording]) -> None:
    """Accelerometer biases of 1.3 and 2.4 m/s^2 came out of it, with sigmas of a fifth."""
    world = worlds("thermal")
    late = replace(world, streams=world.streams | {
        "reference": Series(world.streams["reference"].t + 1.0, world.streams["reference"].value)
    })  # fmt: skip
    with pytest.raises(HandcalError, match="nothing fits"):
        thermal([late])


# --- commands -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A hand's three turns with a gyro that has no scale error, wrong in each way."""
    folder = tmp_path_factory.mktemp("wrong")
    write(simulate("three-turns", seed=5, duration_s=30.0), folder / "sound.mcap")
    imu = handcal.load(folder / "sound.mcap").imu
    out = {}
    for k, (name, attack) in enumerate(ATTACKS.items()):
        t, gyro, accel = (np.ascontiguousarray(x, float) for x in attack(imu.t, imu.gyro,
                                                                         imu.accel))  # fmt: skip
        held = Imu(t, gyro, accel, np.ones(len(t), dtype=np.bool_))
        path = folder / "in" / f"{k:02d}.mcap"
        path.parent.mkdir(exist_ok=True)
        write_mcap(Recording(name, held, {}), path)
        out[name] = str(path)
    return out


@pytest.mark.prove
@pytest.mark.parametrize("name", ATTACKS)
def test_plans_and_live_sessions_of_wrong_readings(monkeypatch, capsys, tmp_path, files, name):
    """`design motion` begins with sigmas that the readings could have brought; `live` finds no
    error where there is none."""
    plan = tmp_path / "plan.json"
    status, _, said = command(monkeypatch, capsys, "design", "motion", "--reduce", "gyro_scale",
                              "--after", files[name], "--json", plan)  # fmt: skip
    assert status in (0, 1, 2)
    assert "Traceback" not in said
    assert plan.exists() == (status == 0)
    if status == 0:
        told = json.loads(plan.read_text("utf-8"))
        sigma = np.array([p["sigma"] for p in told["before"]])
        assert np.isfinite(sigma).all()
        # (what these turns teach at best, of sound readings)
        assert sigma.min() > 0.8e-4
    out = tmp_path / "live"
    status, _, said = command(monkeypatch, capsys, "live", "--from", files[name], "--speed", "0",
                              "--out", out, "--budget", "4")  # fmt: skip
    assert status in (0, 1, 2)
    assert "Traceback" not in said
    if name in REFUSED:
        assert status > 0
        return
    if status == 0:
        found = json.loads((out / "explanation.json").read_text("utf-8"))
        assert found["missing"] == []
        known = json.loads((out / "calibration.json").read_text("utf-8"))["parameters"]
        for p in known:
            if p["effect"] == "gyro_scale":
                assert abs(p["value"]) < SURELY * p["sigma"], p


@pytest.mark.prove
def test_a_fleet_of_wrong_readings_learns_no_error(monkeypatch, capsys, tmp_path, files):
    folder = next(iter(files.values())).rpartition("/")[0]
    status, _, said = command(monkeypatch, capsys, "fleet", folder, "--out", tmp_path / "fleet",
                              "--budget", "4", "--workers", "1")  # fmt: skip
    assert status == 0, said
    told = json.loads((tmp_path / "fleet/fleet.json").read_text("utf-8"))
    assert sum(told["recordings"].values()) == len(files)
    assert told["recordings"]["failed"] >= len(REFUSED)
    assert all(len(f["reason"]) > 20 and "Traceback" not in f["reason"] for f in told["failures"])
    assert set(told["verdicts"]) <= {"nothing_missing", "cannot_tell"}
    for model in told["models"]:
        for p in model["populations"]:
            if p["effect"] == "gyro_scale":
                assert abs(p["mean"]) < SURELY * max(p["mean_sigma"], 1e-9)
