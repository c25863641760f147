"""Simulated laboratory set-ups: what the equipment believes, what is, and the command."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lab_world import command

import handcal
from handcal_sim import lab, motion, scenario
from handcal_sim.errors import SimulationError
from handcal_sim.lab import ARCMIN, ARCSEC, Equipment
from handcal_sim.phone import Phone, Reference

START = motion.Start(heading=0.7)


def built(name, equipment=None, seed=0, duration=None):
    rng = np.random.default_rng(seed)
    return lab.build(name, duration, START, equipment or Equipment(), rng)


def middles(made):
    """The middle of every rest, s."""
    return np.array([0.5 * (a + b) for a, b in made.rests])


@pytest.mark.parametrize("name", lab.SETUPS)
def test_rests_rest_and_nothing_but_their_attitude_differs(name):
    made = built(name)
    assert made.rests[0][0] == 0.0
    assert made.duration_s == pytest.approx(lab.SETUPS[name]().usual_s)
    for a, b in made.rests:
        t = np.linspace(a, b, 7)
        k = motion.evaluate(made, t)
        assert np.abs(k.omega_nb_b).max() < 1e-12
        assert np.abs(k.C_nb - k.C_nb[0]).max() < 1e-12
        assert np.abs(k.position).max() == 0.0


@pytest.mark.parametrize("name", lab.SETUPS)
def test_rates_are_the_derivative_of_the_attitude(name):
    made = built(name, Equipment(20 * ARCMIN, 5 * ARCMIN))
    t = np.random.default_rng(0).uniform(0.0, made.duration_s, 60)
    h = 1e-3
    k = motion.evaluate(made, t)
    C = [motion.evaluate(made, t + s * h).C_nb for s in (-2, -1, 1, 2)]
    slope = (8.0 * (C[2] - C[1]) - (C[3] - C[0])) / (12.0 * h)
    turning = k.C_nb.transpose(0, 2, 1) @ slope
    rate = np.stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]], axis=1)
    # fourth order in 1 ms; the ramps' fifth derivatives stay below 1e5 rad/s^5
    np.testing.assert_allclose(rate, k.omega_nb_b, atol=1e-6)


def test_a_table_shows_every_face_and_edge():
    made = built("table-poses")
    up = motion.evaluate(made, middles(made)).C_nb[:, 2, :]
    want = np.array(list(np.ndindex(3, 3, 3))) - 1.0
    want = want[np.isin(np.abs(want).sum(axis=1), (1, 2))]
    want /= np.linalg.norm(want, axis=1, keepdims=True)
    assert len(up) == len(want) == 18
    assert np.all((up @ want.T).max(axis=0) > 1.0 - 1e-12)


def test_a_dividing_head_steps_by_thirty_degrees_about_each_level_axis():
    made = built("dividing-head")
    C = motion.evaluate(made, middles(made)).C_nb
    for axis in range(3):
        own = C[12 * axis : 12 * axis + 12]
        # the axis of the head lies level and stays where it is; up goes round in the body
        assert np.abs(own[:, :, axis] - own[0, :, axis]).max() < 1e-12
        assert np.abs(own[:, 2, axis]).max() < 1e-12
        j, k = (axis + 1) % 3, (axis + 2) % 3
        angle = np.unwrap(np.arctan2(own[:, 2, j], own[:, 2, k]))
        np.testing.assert_allclose(np.abs(np.diff(angle)), math.radians(30.0), atol=1e-12)


def test_a_rate_table_turns_at_its_rate_about_the_vertical():
    made = built("steady-spins", Equipment(spin=math.radians(200.0)))
    for (_, begin), (end, _) in zip(made.rests[:-1], made.rests[1:], strict=True):
        each = 0.5 * (end - 2.0 - begin)
        for k, sign in ((0, 1.0), (1, -1.0)):
            middle = begin + (k + 0.5) * each
            at = motion.evaluate(made, middle + np.linspace(-0.3, 0.3, 5) * each)
            about_up = at.C_nb @ at.omega_nb_b[:, :, None]
            np.testing.assert_allclose(about_up[:, 2, 0], sign * math.radians(200.0), rtol=1e-12)
            assert np.abs(about_up[:, :2]).max() < 1e-12


def test_position_and_tilt_errors_are_as_asked():
    """100 tables of 18 poses: small rotations between what is and what is believed.

    Of each pose about its three axes (rms known to 1 %), and of the base, the same in all.
    """
    angle, tilt = 30 * ARCSEC, 4 * ARCMIN
    apart, base = [], []
    for seed in range(100):
        made = built("table-poses", Equipment(angle, tilt), seed)
        t = middles(made)[:3]
        C, believed = (motion.evaluate(m, t).C_nb for m in (made, made.commanded))
        turn = C @ believed.transpose(0, 2, 1)
        small = 0.5 * np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0]], 1)
        base.append(small.mean(axis=0))
        apart.append(small - small.mean(axis=0))
    # 100 draws of two numbers: 5 %, four sigma are 20 %
    assert np.sqrt(np.mean(np.square(base))) == pytest.approx(tilt, rel=0.2)
    # each pose's own share about level axes, less their mean of three: between 1/2 and 2 of it
    assert 0.5 * angle < np.sqrt(np.mean(np.square(apart))) < 2.0 * angle
    none = built("table-poses")
    t = middles(none)
    same = (motion.evaluate(m, t).C_nb for m in (none, none.commanded))
    np.testing.assert_array_equal(*same)


def test_the_reference_reads_what_the_table_believes():
    phone = Phone(rate_hz=50.0, reference=Reference())
    world = scenario.simulate(
        "table-poses", seed=0, phone=phone, equipment=Equipment(ARCMIN, ARCMIN)
    )
    exact = scenario.simulate("table-poses", seed=0, phone=phone)
    reference = world.streams["reference"]
    np.testing.assert_array_equal(reference.values, exact.streams["reference"].values)
    missed = world.imu.values[:, 3:] - exact.imu.values[:, 3:]
    assert 0.2 * ARCMIN * 9.8 < np.abs(missed).max() < 10 * ARCMIN * 9.8


def test_a_chamber_holds_its_temperatures_and_warms_the_sensors():
    phone = Phone(rate_hz=20.0, reference=Reference())
    effects = {"accel_temperature": [0.01, 0.0, 0.0], "accel_scale": [0.01, 0.0, 0.0]}
    world = scenario.simulate("soak", seed=0, phone=phone, effects=effects)
    T = world.streams["temperature"]
    made = built("soak")
    assert len(made.rests) == 6 * len(lab.SOAKS)
    for n, (a, b) in enumerate(made.rests):
        own = T.values[(T.stamps >= a) & (T.stamps <= b), 0]
        np.testing.assert_allclose(own, lab.SOAKS[n // 6], atol=1e-9)
    off = world.imu.values[:, 3] - 1.01 * world.truth.f[:, 0]
    want = 0.01 * (np.interp(world.imu.stamps, T.stamps, T.values[:, 0]) - 25.0)
    np.testing.assert_allclose(off, want, atol=1e-9)


def test_durations_and_equipment_that_cannot_be():
    longer = built("table-poses", duration=252.0)
    assert longer.duration_s == pytest.approx(252.0)
    assert longer.rests[1][1] - longer.rests[1][0] == pytest.approx(10.0)
    for wrong in (1.0, math.nan, 1e6):
        with pytest.raises(SimulationError, match="takes"):
            built("table-poses", duration=wrong)
    with pytest.raises(SimulationError, match="by hand"):
        scenario.simulate("static", equipment=Equipment())
    with pytest.raises(SimulationError, match="soak"):
        scenario.simulate("nonsense")


def test_the_command_writes_a_recording_with_its_known_input(tmp_path, monkeypatch, capsys):
    file = tmp_path / "t.mcap"
    options = ("--seed", "1", "--rate", "50", "--table-errors", "20,2", "--no-heading")
    done = command(monkeypatch, capsys, "simulate", "table-poses", "-o", file, *options)
    assert done[0] == 0
    assert "/reference" in done[1]
    recording = handcal.load(file)
    assert set(recording.streams) == {"reference"}
    assert recording.duration_s == pytest.approx(126.0, abs=0.1)
    assert not recording.warnings


@pytest.mark.parametrize(
    "options",
    [
        ["static", "--table-errors", "1,1"],
        ["table-poses", "--table-errors", "1"],
        ["table-poses", "--table-errors", "-1,0"],
        ["steady-spins", "--spin", "0"],
        ["table-poses", "--duration", "3"],
    ],
)
def test_wrong_use_is_one_line(options, tmp_path, monkeypatch, capsys):
    done = command(monkeypatch, capsys, "simulate", *options, "-o", tmp_path / "x.mcap")
    assert done[0] == 2
    assert len(done[2].splitlines()) == 1
    assert not (tmp_path / "x.mcap").exists()
