"""The whole of `handcal live`: a killed server loses nothing it acknowledged, and the page in a
real browser records, stops and shows a verdict."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("aiohttp")

from live_page import Page, rows_of, served
from playwright.sync_api import Browser, expect
from playwright.sync_api import Page as Tab
from sample_recording import sample

from handcal.live.link import NAME, Link
from handcal.recordings import append
from handcal.types import Recording

PHONE = {"width": 390, "height": 844}
DISPATCH = """rows => {
  for (let i = 0; i < rows.t.length; i++) {
    const [alpha, beta, gamma] = rows.gyro[i], [x, y, z] = rows.accel[i];
    const event = new DeviceMotionEvent("devicemotion",
      {rotationRate: {alpha, beta, gamma}, accelerationIncludingGravity: {x, y, z}});
    Object.defineProperty(event, "timeStamp", {value: rows.t[i]});
    dispatchEvent(event);
  }
}"""


def begun(folder: Path) -> tuple[subprocess.Popen[str], Link]:
    """The command, once it has said its link."""
    command = [sys.executable, "-m", "handcal", "live", "--out", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = next(line for line in process.stdout if line.startswith("http"))
    link = Link(**json.loads((folder / NAME).read_text("utf-8")))
    assert line.strip() == link.url
    return process, link


def ended(process: subprocess.Popen[str], number: int) -> str:
    """What it said on stderr after a signal."""
    process.send_signal(number)
    return process.communicate(timeout=60)[1]


def test_a_killed_server_loses_nothing_that_it_acknowledged(tmp_path):
    """The link of the next one is the same, and goes on with the batch that is due."""
    rows = rows_of(sample(n=300, streams=False))
    folder = tmp_path / "out"
    process, link = begun(folder)
    page = Page(link)
    for seq in range(7):
        assert page.post("batch", page.batch(seq, rows[seq]))[1]["next"] == seq + 1
    ended(process, signal.SIGKILL)
    assert len(append.held(folder / "recording.mcap").streams["imu"][0]) == 7 * 25
    process, again = begun(folder)
    try:
        assert again == link
        assert page.post("hello", {"client": "one"})[1]["next"] == 7
        for seq in range(6, len(rows)):  # (the last acknowledgement may have been lost)
            assert page.post("batch", page.batch(seq, rows[seq]))[1]["next"] == seq + 1
    finally:
        ended(process, signal.SIGKILL)
    ns = append.held(folder / "recording.mcap").streams["imu"][0]
    sent = np.concatenate([r["t"] for r in rows])
    assert np.array_equal(ns, np.rint(sent * 1e6).astype(np.int64))


def opened(browser: Browser, link: Link, scheme: Any = "light") -> tuple[Tab, list[str]]:
    """The page on a telephone, started; and what its console complains of."""
    tab = browser.new_page(viewport=PHONE, color_scheme=scheme)
    said: list[str] = []
    tab.on("console", lambda m: said.append(m.text) if m.type == "error" else None)
    tab.on("pageerror", lambda e: said.append(str(e)))
    tab.goto(link.url)
    tab.click("#start")
    tab.wait_for_selector("#stop:visible")
    return tab, said


def moved(tab: Tab, recording: Recording) -> None:
    """Events as the phone would have sent them."""
    imu = recording.imu
    rows = {"t": (imu.t * 1e3).tolist(), "gyro": np.degrees(imu.gyro).tolist(),
            "accel": imu.accel.tolist()}  # fmt: skip
    tab.evaluate(DISPATCH, rows)


def test_the_page_sends_each_event_once_although_the_network_fails(browser, tmp_path):
    recording = sample(n=700, streams=False)
    with served(tmp_path) as (session, link):
        tab, said = opened(browser, link)
        tab.context.set_offline(True)
        moved(tab, recording)
        tab.wait_for_selector("#error:visible")
        assert "kept" in tab.inner_text("#error")
        tab.context.set_offline(False)
        expect(tab.locator("#waiting")).to_have_text("0")
        expect(tab.locator("#rate")).to_have_text("100 Hz")
        assert tab.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        out = session.recording()
        assert all("INTERNET_DISCONNECTED" in line for line in said), said
        tab.close()
    assert out is not None
    assert np.array_equal(out.imu.gyro, np.radians(np.degrees(recording.imu.gyro)))
    assert np.array_equal(out.imu.accel, recording.imu.accel)
    assert np.abs(out.imu.t - recording.imu.t).max() < 1e-6  # (a double of ms since 1970)


SENSORS = """() => {
  window.made = {};
  const kind = (name) => class extends EventTarget {
    constructor(options) { super(); window.made[name] = this; this.options = options; }
    start() { this.started = true; }
    stop() { this.started = false; }
    tell(t, [x, y, z]) {
      Object.assign(this, {timestamp: t, x, y, z}); this.dispatchEvent(new Event("reading"));
    }
  };
  window.Gyroscope = kind("gyro"); window.Accelerometer = kind("accel");
}"""
TELL = """rows => {
  const {gyro, accel} = window.made;
  for (let i = 0; i < rows.t.length; i++) {
    gyro.tell(rows.t[i], rows.gyro[i]);
    accel.tell(rows.t[i] + rows.after, rows.accel[i]);
  }
}"""


@pytest.mark.parametrize("after", [0.0, 4.0])
def test_sensors_that_speak_for_themselves_are_read_so(browser, tmp_path, after):
    """The Generic Sensor API where it is: rates as they are read, forces at the rates' stamps;
    motion events are then not listened to."""
    recording = sample(n=400, streams=False)
    imu = recording.imu
    rows = {"t": (1e3 * imu.t).tolist(), "gyro": imu.gyro.tolist(), "accel": imu.accel.tolist(),
            "after": after}  # fmt: skip
    with served(tmp_path) as (session, link):
        tab = browser.new_page(viewport=PHONE)
        tab.add_init_script(f"({SENSORS})()")
        tab.goto(link.url)
        tab.click("#start")
        tab.wait_for_function("window.made.gyro && window.made.gyro.started")
        tab.evaluate(TELL, rows)
        tab.wait_for_selector("#stop:visible")
        moved(tab, recording)
        expect(tab.locator("#rate")).to_have_text("100 Hz")
        expect(tab.locator("#waiting")).to_have_text("0")
        out = session.recording()
        assert session.note["api"] == "sensor"
        tab.close()
    assert out is not None
    first = 0 if after == 0.0 else 1
    n = len(out.imu.t)
    assert n == len(imu.t) - first
    assert np.array_equal(out.imu.gyro, imu.gyro[first:])
    t = 1e3 * imu.t
    forces = [np.interp(t[first:], t + after, axis) for axis in imu.accel.T]
    np.testing.assert_allclose(out.imu.accel, np.stack(forces, axis=1), atol=1e-3)
    if after == 0.0:
        assert np.array_equal(out.imu.accel, imu.accel)


@pytest.mark.prove
def test_virtual_sensors_of_a_real_browser(browser, tmp_path):
    """Chromium's own sensors, set through the developer protocol; when they fall silent, motion
    events take over."""
    with served(tmp_path) as (session, link):
        context = browser.new_context(viewport=PHONE)
        tab = context.new_page()
        protocol = context.new_cdp_session(tab)
        metadata = {"available": True, "minimumFrequency": 1, "maximumFrequency": 100}

        def read(kind: str, x: float) -> None:
            reading = {"xyz": {"x": x, "y": 0.2, "z": 9.8}}
            protocol.send("Emulation.setSensorOverrideReadings", {"type": kind, "reading": reading})

        kinds = ("gyroscope", "accelerometer")
        for kind in kinds:
            given = {"enabled": True, "type": kind, "metadata": metadata}
            protocol.send("Emulation.setSensorOverrideEnabled", given)
        tab.goto(link.url)
        tab.evaluate("document.getElementById('start').click()")
        fed = np.round(np.arange(0.1, 6.0, 0.1), 1)
        for x in fed:
            for kind in kinds:
                read(kind, float(x))
            time.sleep(0.025)
        tab.wait_for_selector("#stop:visible")
        tab.wait_for_timeout(600)
        out = session.recording()
        assert session.note["api"] == "sensor"
        tab.wait_for_timeout(1800)  # (longer than they may be silent)
        assert session.note["api"] == "motion"
        whole = session.recording()
        context.close()
    assert out is not None
    assert whole is not None
    # (Chromium rounds to 0.1 deg/s and 0.1 m/s^2, and gives 60 readings a second of those set)
    step = np.radians(0.1)
    x = out.imu.gyro[:, 0]
    assert len(x) > 0.5 * len(fed)
    np.testing.assert_allclose(x / step, np.rint(x / step), atol=1e-6)
    assert np.abs(fed[:, None] - x).min(axis=0).max() < step
    assert np.all(np.diff(x) > 0.0)
    between = np.interp(x, fed, fed)
    assert np.abs(out.imu.accel[:, 0] - between).max() < 0.25  # (set a moment after the rate)
    np.testing.assert_allclose(out.imu.accel[:, 2], 9.8, atol=1e-9)
    events = whole.imu
    assert len(events.t) > len(x) + 10
    np.testing.assert_allclose(events.gyro[len(x) :, 0], fed[-1], atol=step)
    np.testing.assert_allclose(events.accel[len(x) :, 2], 9.8, atol=0.05)


@pytest.mark.prove
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_from_the_page_to_the_verdict(browser, tmp_path, scheme):
    """A turn is simulated with a scale error: killed and started again in the middle, the page
    goes on, and at the end it names the error; `handcal explain` of the file says the same."""
    import handcal
    from handcal_sim import simulate, write

    write(simulate("three-turns", seed=1, duration_s=20.0,
                   effects={"gyro_scale": [0.01, -0.008, 0.006]}), tmp_path / "x.mcap")  # fmt: skip
    recording = handcal.load(tmp_path / "x.mcap")
    folder = tmp_path / "out"
    process, link = begun(folder)
    tab, _ = opened(browser, link, scheme)
    moved(tab, recording)
    tab.wait_for_selector("#bars tr", timeout=60_000)
    picture = os.environ.get("HANDCAL_PICTURES")
    if picture:
        tab.screenshot(path=f"{picture}/recording-{scheme}.png")
    ended(process, signal.SIGKILL)
    process, again = begun(folder)
    assert again == link
    tab.click("#stop")
    tab.wait_for_selector("#verdict:visible", timeout=120_000)
    if picture:
        tab.screenshot(path=f"{picture}/verdict-{scheme}.png")
    assert "gyro scale error" in tab.inner_text("#headline")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert tab.inner_text("#headline").replace("\xa0", " ") in out.replace("\xa0", " ")
    tab.close()
    found = json.loads((folder / "explanation.json").read_text("utf-8"))
    own = handcal.explain(folder / "recording.mcap").document
    for key in ("verdict", "missing", "parameters"):
        assert found[key] == json.loads(json.dumps(own[key])), key
    calibration = json.loads((folder / "calibration.json").read_text("utf-8"))
    assert "gyro_scale" in {p["effect"] for p in calibration["parameters"]}
    assert (folder / "report.html").stat().st_size > 10_000
    assert len(handcal.load(folder / "recording.mcap").imu.t) == len(recording.imu.t)
