"""The whole of `handcal live`: a killed server loses nothing it acknowledged, and the page in a
real browser records, stops and shows a verdict."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
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
    assert tab.inner_text("#headline") in out
    tab.close()
    found = json.loads((folder / "explanation.json").read_text("utf-8"))
    own = handcal.explain(folder / "recording.mcap").document
    for key in ("verdict", "missing", "parameters"):
        assert found[key] == json.loads(json.dumps(own[key])), key
    calibration = json.loads((folder / "calibration.json").read_text("utf-8"))
    assert "gyro_scale" in {p["effect"] for p in calibration["parameters"]}
    assert (folder / "report.html").stat().st_size > 10_000
    assert len(handcal.load(folder / "recording.mcap").imu.t) == len(recording.imu.t)
