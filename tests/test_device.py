"""What is known of a device over time: sessions multiply, biases fade, contradictions are said."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from fake_result import fake_result
from worlds import recording_of

import handcal
from handcal import calibrate
from handcal.commands import _app
from handcal.device import file as device_file
from handcal.device import history
from handcal.device.file import Device, Session
from handcal.recordings.overview import overview
from handcal.show.calibration.summary import calibration_json, write_json
from handcal.show.device import _tables, surprise_sentences, write_device_report
from handcal.show.info import Info, write_info_report
from handcal.types import GYRO_BIAS_PRIOR, InputError
from handcal_sim import simulate
from handcal_sim.phone import Clocking, consumer_phone, with_rate

DAY = datetime(2026, 5, 1, tzinfo=UTC)
SCALE = (0.005, -0.004, 0.003)


def slow(_):
    """One phone that writes a fifth as much."""
    phone = with_rate(consumer_phone(np.random.default_rng(0)), 50.0)
    return replace(phone, heading=replace(phone.heading, clocking=Clocking(10.0)))


def recorded(seed, scale=SCALE, day=0.0):
    world = simulate(
        "free-hand", seed=seed, duration_s=40.0, phone=slow, effects={"gyro_scale": scale}
    )
    ns = int((DAY + timedelta(days=day)).timestamp()) * 10**9
    return replace(recording_of(world, "heading"), path=f"session-{seed}", start_ns=ns)


def session(result, tmp_path, name="x"):
    path = tmp_path / f"{name}.json"
    write_json(calibration_json(result), path)
    return device_file.session_of(path, device_file.read_result(path), "phone")


@pytest.fixture(scope="module")
def first():
    return calibrate(recorded(0), ["gyro_scale"], only=True)


@pytest.fixture(scope="module")
def told(first, tmp_path_factory):
    """The device after the first session, and the second session alone and with that."""
    folder = tmp_path_factory.mktemp("told")
    known = Device("phone", (session(first, folder),), "f" * 64)
    second = recorded(1, day=30.0)
    before = history.prior(known, DAY + timedelta(days=30), None, "phone.toml")
    alone = calibrate(second, ["gyro_scale"], only=True)
    return known, alone, calibrate(second, ["gyro_scale"], before=before, only=True)


def block(result):
    at = [i for i, p in enumerate(result.parameters) if p.effect == "gyro_scale"]
    mean = np.array([result.parameters[i].value for i in at])
    return mean, result.covariance[np.ix_(at, at)]


def test_a_second_session_knows_what_the_product_of_gaussians_knows(first, told):
    (m0, C0), (m1, C1), (m, C) = block(first), block(told[1]), block(told[2])
    I0, I1, prior = np.linalg.inv(C0), np.linalg.inv(C1), np.eye(3) / 0.01**2
    expected = np.linalg.inv(I0 + I1 - prior)
    assert np.sqrt(np.diag(C)) == pytest.approx(np.sqrt(np.diag(expected)), rel=0.05)
    mean = expected @ (I0 @ m0 + I1 @ m1)
    assert np.abs(m - mean) / np.sqrt(np.diag(expected)) == pytest.approx(0.0, abs=0.3)
    assert (np.abs(m - SCALE) < 4.0 * np.sqrt(np.diag(C))).all()


def test_what_was_known_before_does_not_count_as_said_again(told, tmp_path):
    """Of a result made with the device file, the session's own say is what it says without."""
    alone, after = (session(r, tmp_path, n) for r, n in zip(told[1:], "ab", strict=True))
    names = [n for n in alone.names if n[0] == "gyro_scale"]
    one, other = (history.plain(s, names) for s in (without_biases(alone), without_biases(after)))
    assert other.sigma == pytest.approx(one.sigma, rel=0.1)
    assert (np.abs(other.mean - one.mean) / one.sigma).max() < 0.5


def without_biases(s):
    at = [i for i, n in enumerate(s.names) if n[0] == "gyro_scale"]
    grid = np.ix_(at, at)
    return replace(
        s, names=tuple(s.names[i] for i in at), mean=s.mean[at], covariance=s.covariance[grid],
        prior_mean=s.prior_mean[at], prior_covariance=s.prior_covariance[grid], likelihood=None,
    )  # fmt: skip


def made(day, **values):
    """A session that tells these parameters, each (mean, sigma)."""
    names = tuple((n.rpartition("_")[0], n.rpartition("_")[2]) for n in values)
    mean, sigma = (np.array([v[k] for v in values.values()]) for k in (0, 1))
    usual = device_file.usual_of(names)
    return Session(
        DAY + timedelta(days=day), None, ("x",), (f"{day}",), names, mean, np.diag(sigma**2),
        np.zeros(len(names)), np.diag(usual**2),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("days", "least", "most"), [(0.05, 0.2, 0.3), (30.0, 0.7, 0.9), (365.0, 0.99, 1.0)]
)
def test_an_old_bias_gives_hardly_anything(days, least, most):
    """Of 3 deg/s known to 0.1 %: sigma in units of the usual prior; its scale stays known."""
    bias, scale = 3.0 * GYRO_BIAS_PRIOR, 0.004
    known = Device("phone", (made(0, gyro_bias_x=(bias, 1e-3 * bias), gyro_scale_x=(scale, 1e-4)),))
    then = history.prior(known, DAY + timedelta(days=days), None, "")
    sigma = np.sqrt(np.diag(then.covariance))
    assert then.names == (("gyro_bias", "x"), ("gyro_scale", "x"))
    assert least <= sigma[0] / GYRO_BIAS_PRIOR <= most
    assert sigma[1] == pytest.approx(1e-4, rel=1e-3)
    if days > 300:
        assert abs(then.mean[0]) < 0.01 * bias


def test_temperature_counts_where_it_is_known():
    known = Device("phone", (replace(made(0, gyro_bias_x=(0.0, 1e-5)), temperature=20.0),))
    same, unknown, far = (
        float(history.prior(known, DAY, degrees, "").covariance[0, 0])
        for degrees in (20.0, None, 35.0)
    )
    assert math.sqrt(same) < 2e-5 < math.sqrt(unknown) < math.sqrt(far)


@pytest.fixture(scope="module")
def changed(first, told):
    """By how much the scale of x changed before the second session, and what that tells."""
    by = 20.0 * math.sqrt(block(first)[1][0, 0] + block(told[1])[1][0, 0])
    recording = recorded(1, (SCALE[0] + by, *SCALE[1:]), day=30.0)
    return by, calibrate(recording, ["gyro_scale"], before=told[2].before, only=True)


def test_a_scale_that_changed_by_20_sigma_is_reported(told, changed, tmp_path):
    by, third = changed
    known = device_file.added(told[0], session(third, tmp_path))
    (found,) = history.disagreements(known)
    assert (found.first, found.second, found.effect, found.name) == (1, 2, "gyro_scale", "x")
    assert found.sigmas == pytest.approx(20.0, abs=4.0)
    now = history.prior(known, DAY + timedelta(days=31), None, "")
    k = now.names.index(("gyro_scale", "x"))
    assert math.sqrt(now.covariance[k, k]) > 0.4 * by  # (no better known than they are apart)
    assert not history.disagreements(device_file.added(told[0], session(told[1], tmp_path, "b")))


def test_a_recording_that_contradicts_the_file_is_told(told, changed):
    third = changed[1]
    (said,) = surprise_sentences(third.before, third.parameters, third.covariance)
    assert "gyro scale" in said
    assert not surprise_sentences(told[2].before, told[2].parameters, told[2].covariance)


def test_a_device_file_is_read_as_it_was_written(told, tmp_path):
    known = replace(told[0], name='a "phone"\x7f')
    device_file.write(device_file.added(known, session(told[2], tmp_path)), tmp_path / "p.toml")
    again = device_file.read(tmp_path / "p.toml")
    assert again.name == known.name
    assert len(again.sessions) == 2
    for name in ("mean", "covariance", "prior_mean", "prior_covariance"):
        old, new = getattr(session(told[2], tmp_path), name), getattr(again.sessions[1], name)
        np.testing.assert_array_equal(old, new)
    assert again.sessions[0].recorded == DAY


@pytest.mark.parametrize(
    "text",
    [
        "", "x", 'schema = "handcal/device/1"', 'schema = "other"\nname = "x"',
        'schema = "handcal/device/1"\nname = "x"\nsession = 3',
        'schema = "handcal/device/1"\nname = "x"\n[[session]]\nrecorded = 2026-05-01',
        'schema = "handcal/device/1"\nname = "x"\n[[session]]\nrecorded = 2026-05-01T00:00:00Z\n'
        'recordings = []\nsha256 = []\nparameters = ["gyro_scale.x"]\nmean = [0.0]\n'
        "covariance = [[-1.0]]",
        'schema = "handcal/device/1"\nname = "x"\n[[session]]\nrecorded = 2026-05-01T00:00:00Z\n'
        'recordings = []\nsha256 = []\nparameters = ["heading_delay.delay"]\nmean = [0.0]\n'
        "sigma = [1.0]",
    ],
)  # fmt: skip
def test_a_damaged_file_is_a_sentence(text, tmp_path):
    path = tmp_path / "p.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        device_file.read(path)
    assert str(path) in str(caught.value)


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """The command line in this process, in a folder of its own: status, output, errors."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["handcal", *arguments])
        with pytest.raises(SystemExit) as stop:
            _app.main()
        said = capsys.readouterr()
        return stop.value.code, said.out, said.err

    return call


def test_the_command_line_keeps_devices_apart(first, told, tmp_path, run):
    for name, result in (("a", first), ("b", told[2])):
        document = calibration_json(result)
        document["recording"]["sha256"] = name * 64
        write_json(document, tmp_path / f"{name}.json")
    added = run("device", "add", "phone.toml", "a.json", "b.json")
    assert added[:2] == (0, "phone.toml: 2 sessions\n")
    only = "its biases and gyro_scale."
    assert [line.endswith(only) for line in added[2].splitlines()] == [True, True]
    for wrong, said in (
        (("phone.toml", "a.json"), "already"),
        (("phone.toml", "a.json", "--name", "other"), "mixed"),
        (("other.toml", "b.json"), "mixed"),
        (("new.toml", "phone.toml"), "JSON"),
    ):
        status, _, err = run("device", "add", *wrong)
        assert status == 2
        assert said in err
        assert len(err.splitlines()) == 1
    shown = json.loads(run("device", "show", "phone.toml", "--json", "-")[1])
    sigma = {(p["effect"], p["name"]): p["sigma"] for p in shown["parameters"]}
    assert sigma["gyro_scale", "x"] == pytest.approx(math.sqrt(block(told[2])[1][0, 0]), rel=0.05)


def test_what_a_device_file_does_not_keep_is_said(first, tmp_path, run):
    document = calibration_json(first)
    row = document["parameters"][0]
    others = (
        "mag_hard_iron.x",
        "heading_delay.delay",
        "gravity.delta",
        "gyro_bias_step.x",
        "odd.k",
    )
    for name in others:
        effect, _, of = name.partition(".")
        document["parameters"].append({**row, "effect": effect, "name": of})
    write_json(document, tmp_path / "a.json")
    status, _, err = run("device", "add", "phone.toml", "a.json")
    assert status == 0
    said = err.partition("Not kept: ")[2]
    assert said.startswith("mag_hard_iron, heading_delay (of a stream beside gyro")
    assert "gravity (of the place" in said
    assert "gyro_bias_step (of one day" in said
    assert "odd (no effect of the catalogue)" in said
    assert "gyro_scale" not in said


def test_a_result_says_which_device_file_it_began_with(told):
    document = calibration_json(told[2])
    assert document["device"]["sha256"] == "f" * 64
    assert document["device"]["name"] == "phone"
    assert "device" not in calibration_json(told[1])
    json.dumps(document, allow_nan=False)


def test_a_bias_of_last_year_is_forgotten():
    bias = 0.3 * GYRO_BIAS_PRIOR
    device = Device("phone", (made(0, gyro_bias_x=(bias, 1e-5), gyro_scale_x=(1e-7, 1e-4)),))
    for days, gone in ((5, False), (365, True)):
        rows = {r[0]: r for r in list(_tables(device, DAY + timedelta(days=days)))[1][2]}
        assert (rows["Gyro bias x"][1] == "forgotten") == gone
        assert "forgotten" not in rows["Gyro scale x"]
        assert not set("+-−") & set(rows["Gyro scale x"][1]), "a zero has no sign"


def test_the_page_draws_each_parameter(told, tmp_path):
    known = Device("phone", (*told[0].sessions, made(30, gyro_scale_x=(0.005, 1e-4))))
    write_device_report(known, DAY + timedelta(days=40), tmp_path / "x.html")
    page = (tmp_path / "x.html").read_text()
    assert page.count("<figure") == 3
    assert ">nan" not in page


def test_no_page_is_wider_than_a_telephone(browser, tmp_path):
    """However long the names are, and whatever is drawn."""
    long = "a_telephone_that_was_turned_about_all_axes" * 3
    known = Device(long, (replace(made(0, gyro_bias_x=(0.01, 1e-3)), recordings=(long,)),))
    write_device_report(known, DAY, tmp_path / "device.html")
    fake = fake_result()
    recording = replace(fake.recording, path=f"{long}.mcap")
    write_info_report(Info("x", long, overview(recording), ()), tmp_path / "info.html")
    tab = browser.new_page(viewport={"width": 390, "height": 800})
    for page in ("device", "info"):
        tab.goto((tmp_path / f"{page}.html").as_uri())
        assert tab.evaluate("document.documentElement.scrollWidth") <= 390, page


@pytest.mark.prove
def test_explain_begins_with_what_is_known(told):
    before = told[2].before
    found = handcal.explain(recorded(1, day=30.0), before=before)
    assert found.verdict == "explained"
    (mine,) = [p for p in found.parameters if (p.effect, p.name) == ("gyro_scale", "x")]
    assert mine.sigma == pytest.approx(math.sqrt(block(told[2])[1][0, 0]), rel=0.2)
    assert found.device is before
