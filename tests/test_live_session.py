"""A live session records what is sent to it, once, and nothing that it should not."""

from __future__ import annotations

import stat
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handcal.live.ending import browsers_limits, with_convention
from handcal.live.link import NAME
from handcal.live.recorder import opened
from handcal.live.session import Refused, Session
from handcal.live.sources import browser, file
from handcal.live.sources.browser import OLD_ORDER, Convention
from handcal.motions import MOTIONS, recording_of
from handcal.recordings import append
from handcal.recordings.inputs import load
from handcal.types import InputError, Recording

pytest.importorskip("aiohttp")

from live_page import Page, rows_of, served
from sample_recording import sample


@pytest.fixture(scope="module")
def fed() -> Recording:
    return sample(n=500, streams=False)


@pytest.fixture(scope="module")
def rows(fed: Recording) -> list[dict[str, Any]]:
    return rows_of(fed)


def equals(path: Path, rows: list[dict[str, Any]]) -> None:
    """That a file holds these rows, each once, to the last bit."""
    ns, value = append.held(path).streams["imu"]
    sent = np.concatenate([r["t"] for r in rows])
    assert np.array_equal(ns, np.rint(sent * 1e6).astype(np.int64))
    assert np.array_equal(value[:, :3], np.radians(np.vstack([r["gyro"] for r in rows])))
    assert np.array_equal(value[:, 3:], np.vstack([r["accel"] for r in rows]))


def test_what_is_recorded_is_what_was_sent(tmp_path, rows):
    """Also where acknowledgements were lost and batches were sent again."""
    with served(tmp_path) as (session, link):
        page = Page(link)
        assert page.post("hello", {"client": "one"})[1]["next"] == 0
        for seq, some in enumerate(rows):
            for _ in range(3 if seq % 4 == 1 else 1):
                status, said = page.post("batch", page.batch(seq, some))
                assert (status, said["next"]) == (200, seq + 1)
        assert said["samples"] == 500
        assert said["rate_hz"] == pytest.approx(100, rel=0.05)
        assert page.post("batch", page.batch(len(rows) + 1, rows[0]))[0] == 409  # (too early)
        equals(session.recorder.path, rows)
        recording = load(session.recorder.path)  # (readable without an end)
        assert len(recording.imu.t) == 500


def test_what_is_refused_leaves_the_session_going(tmp_path, rows):
    with served(tmp_path) as (session, link):
        page, other = Page(link), Page(link, "two")
        assert page.post("batch", page.batch(0, rows[0]))[0] == 200
        bad = rows[1]
        refused = [
            (400, b"["),
            (400, b"[" * 100_000),
            (400, page.batch(1, bad | {"gyro": [[float("nan")] * 3] * 25})),
            (400, page.batch(1, bad | {"accel": [[10**400, 0, 0]] * 25})),
            (400, page.batch(1, bad | {"accel": [["1", 0, 0]] * 25})),
            (400, page.batch(1, bad | {"accel": bad["accel"][:-1]})),
            (400, page.batch(1, bad | {"t": [t + 1e8 for t in bad["t"]]})),
            (400, page.batch(1, bad | {"t": [-1.0] * 25})),
            (400, page.batch(True, bad)),
            (413, b" " * (256 * 1024 + 1)),
        ]
        for status, body in refused:
            assert page.post("batch", body)[0] == status, body
        assert other.post("batch", other.batch(1, bad))[0] == 409
        assert page.ask("GET", "/wrong/state")[0] == 403
        assert page.ask("GET", f"/{link.token[:-1]}/state")[0] == 403
        assert page.ask("GET", f"/{link.token}/../../etc/passwd")[0] in (403, 404)
        assert page.post("state", b"", Host="elsewhere.example")[0] == 403
        status, said = page.post("batch", b"{}", **{"Content-Length": str(10**9)})
        assert status == 413
        status, said = page.post("batch", page.batch(0, bad))  # (an old number with new readings)
        assert (status, said["next"], said["samples"]) == (200, 1, 25)
        assert page.post("batch", page.batch(1, rows[1]))[0] == 200
        equals(session.recorder.path, rows[:2])


def test_a_silent_page_gives_way_and_a_flood_is_slowed(tmp_path, rows):
    now = [0.0]
    with served(tmp_path, lambda: now[0]) as (_, link):
        page, other = Page(link), Page(link, "two")
        page.post("batch", page.batch(0, rows[0]))
        assert other.post("hello", {"client": "two"})[0] == 409
        now[0] = 11.0
        assert other.post("hello", {"client": "two"})[1]["next"] == 1
        assert 429 in {page.ask("GET", f"/{link.token}/state")[0] for _ in range(200)}


def test_a_page_may_reach_nothing_else_and_the_link_is_kept_for_its_owner(tmp_path):
    import urllib.request

    with served(tmp_path) as (_, link):
        with urllib.request.urlopen(link.url) as answer:
            policy = answer.headers["Content-Security-Policy"]
            text = answer.read().decode()
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "://" not in text
        assert stat.S_IMODE((tmp_path / NAME).stat().st_mode) == 0o600
    with served(tmp_path) as (_, again):
        assert again == link


def test_in_a_network_the_page_is_encrypted_unless_told_otherwise(tmp_path, monkeypatch):
    """With a certificate of its own for the address that is told; the link stays the folder's."""
    import ssl
    import urllib.request

    from handcal.live import link as links

    monkeypatch.setattr(links, "own_address", lambda: "127.0.0.1")
    kept = links.link_of(tmp_path, True, None)
    assert kept.url.startswith("https://127.0.0.1:")
    assert links.link_of(tmp_path, True, None) == kept
    assert stat.S_IMODE((tmp_path / NAME).stat().st_mode) == 0o600
    assert links.qr(kept.url).count("\n") > 10
    begin = kept.certificate.index("-----BEGIN CERTIFICATE")  # (behind the key)
    trusting = ssl.create_default_context(cadata=kept.certificate[begin:])
    trusting.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN  # (its maker's key was thrown away)
    with served(tmp_path, link=kept) as (_, link):
        with urllib.request.urlopen(link.url, context=trusting) as answer:
            assert answer.status == 200
        with pytest.raises(OSError, match=r"."):
            urllib.request.urlopen(link.url.replace("https", "http"), timeout=5).read()
        with pytest.raises(OSError, match="CERTIFICATE_VERIFY"):
            urllib.request.urlopen(link.url, context=ssl.create_default_context())
    plain = links.link_of(tmp_path, True, None, plain=True)
    assert plain.url.startswith("http://")
    assert plain.token == kept.token


def test_a_batch_may_hold_nothing_new_of_a_stream(tmp_path, rows):
    """Samples that came before are left out; what comes with them is recorded."""
    session = Session(opened(tmp_path / "recording.mcap"))
    first = browser.parse(_json(0, rows[0]))
    session.take(first)
    warm = first.ns[-1:] + 1, np.full((1, 1), 21.0)
    session.take(replace(first, seq=1, further={"temperature": warm}))
    session.recorder.close()
    held = append.held(tmp_path / "recording.mcap")
    assert session.next == 2
    assert np.array_equal(held.streams["imu"][0], first.ns)
    assert held.streams["temperature"][1] == 21.0
    assert held.note["seq"] == 1


@pytest.mark.parametrize("torn", [1, 40, 2000])
def test_a_file_that_was_torn_off_goes_on_behind_its_last_whole_batch(tmp_path, rows, torn):
    path = tmp_path / "recording.mcap"
    session = Session(opened(path))
    for seq, some in enumerate(rows[:10]):
        session.take(browser.parse(_json(seq, some)))
    session.recorder.close()
    path.write_bytes(path.read_bytes()[:-torn])
    again = Session(opened(path))
    assert 10 - again.next == (1 if torn < 2000 else 2)
    for seq in range(again.next, len(rows)):
        again.take(browser.parse(_json(seq, rows[seq])))
    again.recorder.close()
    equals(path, rows)


def _json(seq: int, some: dict[str, Any]) -> bytes:
    import json

    return json.dumps({"client": "one", "seq": seq, **some}).encode()


def test_a_recording_that_has_ended_is_not_gone_on_with(tmp_path, fed):
    from handcal.recordings.export import write_mcap

    write_mcap(fed, tmp_path / "recording.mcap")
    before = (tmp_path / "recording.mcap").read_bytes()
    with pytest.raises(InputError, match="ended"):
        opened(tmp_path / "recording.mcap")
    assert (tmp_path / "recording.mcap").read_bytes() == before


def test_a_recording_is_fed_at_its_own_pace_and_comes_out_the_same(tmp_path):
    recording = sample(n=500)
    slept: list[float] = []
    session = Session(opened(tmp_path / "recording.mcap"), clock=lambda: 0.0)
    file.feed(recording, session, 20.0, slept.append)
    assert slept[-1] == pytest.approx(5.0 / 20.0, abs=0.25 / 20.0)
    out = session.recording()
    assert out is not None
    assert out.start_ns == recording.start_ns
    assert np.array_equal(out.imu.t, recording.imu.t)
    assert np.array_equal(out.imu.gyro, recording.imu.gyro)
    assert np.array_equal(out.imu.accel, recording.imu.accel)
    for name, series in recording.streams.items():
        own = out.streams[name]
        inside = (series.t >= 0.0) & (series.t <= recording.imu.t[-1])
        assert np.array_equal(own.value, series.value[inside][: len(own.value)]), name
        assert len(own.value) >= inside.sum() - 30, name
    session.state = "working"
    with pytest.raises(Refused):
        session.take(next(file.batches(recording))[1])
    session.recorder.close()


@pytest.fixture(scope="module")
def turned() -> Recording:
    """Once about each axis and back, from a rest on the back."""
    return recording_of(MOTIONS[3], sample(streams=False), np.array([0.0, 0.0, -9.80665]))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("order", [(0, 1, 2), OLD_ORDER])
def test_turns_tell_the_axes_and_the_first_rest_the_sign(turned, order, sign):
    """However a browser mixes them up, what is made of it is the truth."""
    mixed = np.empty_like(turned.imu.gyro)
    mixed[:, list(order)] = turned.imu.gyro
    rng = np.random.default_rng(0)
    mixed += rng.normal(0.0, 0.01, mixed.shape)
    accel = sign * turned.imu.accel + rng.normal(0.0, 0.05, mixed.shape)
    found = browser.told(turned.imu.t, mixed, accel)
    assert found is not None
    assert (found.order, found.sign) == (order, sign)
    imu = replace(turned.imu, gyro=mixed, accel=accel)
    mended = with_convention(replace(turned, imu=imu), found).imu
    assert np.abs(mended.gyro - turned.imu.gyro).max() < 0.1
    assert np.abs(mended.accel - turned.imu.accel).max() < 0.5
    n = round(3.0 / float(np.diff(turned.imu.t[:2])[0]))
    assert browser.told(turned.imu.t[:n], mixed[:n], accel[:n]) is None  # (too little turned)


def test_no_change_is_no_change(turned):
    same = with_convention(turned, Convention())
    assert np.array_equal(same.imu.gyro, turned.imu.gyro)
    assert np.array_equal(same.imu.accel, turned.imu.accel)


def test_what_a_browser_takes_from_readings_is_said():
    """Rounded to 0.1 deg/s and 0.1 m/s^2, 60 Hz, a bias of zero: each for itself."""
    exact = sample(n=600, streams=False)
    imu = exact.imu
    gyro = imu.gyro + np.radians([0.3, -0.2, 0.4])
    plain = replace(exact, imu=replace(imu, gyro=gyro))
    assert list(browsers_limits(plain)) == []
    rounded = replace(imu, gyro=np.radians(np.round(np.degrees(gyro), 1)),
                      accel=np.round(imu.accel, 1))  # fmt: skip
    (said,) = browsers_limits(replace(exact, imu=rounded))
    assert "rounds to 0.1 deg/s" in said
    slow = replace(imu, t=imu.t * 100 / 60, gyro=gyro)
    (said,) = browsers_limits(replace(exact, imu=slow))
    assert "60 readings a second" in said
    first = imu.t < 2.0
    (said,) = browsers_limits(
        replace(exact, imu=replace(imu, gyro=gyro - gyro[first].mean(axis=0)))
    )
    assert "takes its bias off" in said
