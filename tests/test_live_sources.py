"""Apps and recorders that a live session listens to, each against what speaks its format."""

from __future__ import annotations

import json
import struct
import threading
import time
import urllib.parse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import numpy as np
import pytest

pytest.importorskip("aiohttp")

from format_files import ros2_bag
from live_page import Page, running, served
from sample_recording import sample

from handcal.live.recorder import opened
from handcal.live.session import Session
from handcal.live.sources import foxglove, mcap, phyphox
from handcal.live.sources.pairing import Pairing
from handcal.recordings import append
from handcal.recordings.export import messages, write_mcap
from handcal.recordings.inputs import Options, load
from handcal.recordings.streams import STREAMS
from handcal.types import HandcalError, InputError, Recording

START_NS = 1_760_000_000_000_000_000
G = 9.80665


@pytest.fixture(scope="module")
def recording() -> Recording:
    return replace(sample(n=600), start_ns=START_NS)


def stamps(recording: Recording) -> np.ndarray:
    return START_NS + np.rint(recording.imu.t * 1e9).astype(np.int64)


def has_all(session: Session, recording: Recording) -> None:
    out = session.recording()
    assert out is not None
    assert np.array_equal(out.imu.t, recording.imu.t)
    assert np.array_equal(out.imu.gyro, recording.imu.gyro)
    assert np.array_equal(out.imu.accel, recording.imu.accel)
    for name, series in recording.streams.items():
        assert np.array_equal(out.streams[name].value, series.value), name


def pushes(recording: Recording, apple: bool, shift_ns: int = 0) -> list[dict[str, Any]]:
    """What Sensor Logger sends of a recording in messages of half a second: each sensor with its
    own stamps, of iOS in g with the other sign. Its linear acceleration is of no use."""
    imu, ns = recording.imu, stamps(recording)
    unit = -1.0 / G if apple else 1.0
    mag = recording.streams["mag"]
    rows = [("gyroscopeuncalibrated", int(n), w) for n, w in zip(ns, imu.gyro, strict=True)]
    rows += [("accelerometeruncalibrated", int(n) + shift_ns, unit * f)
             for n, f in zip(ns, imu.accel, strict=True)]  # fmt: skip
    rows += [("accelerometer", int(n), 0.0 * w) for n, w in zip(ns, imu.gyro, strict=True)]
    rows += [("magnetometeruncalibrated", START_NS + round(t * 1e9), 1e6 * b)
             for t, b in zip(mag.t, mag.value, strict=True)]  # fmt: skip
    out = []
    for number in range(12):
        begin = START_NS + number * 500_000_000
        payload = [
            {"name": name, "time": n, "accuracy": 3,
             "values": dict(zip("xyz", map(float, v), strict=True))}
            for name, n, v in rows
            if begin <= n < begin + 500_000_000
        ]  # fmt: skip
        message = {"messageId": number, "sessionId": "s", "deviceId": "d", "payload": payload}
        out.append(message)
    return out


@pytest.mark.parametrize("apple", [False, True])
def test_sensor_logger_pushes(tmp_path, recording, apple):
    """One message comes twice, and the server is started anew in between."""
    messages = pushes(recording, apple)
    for some in (messages[:5], messages[3:]):
        with served(tmp_path) as (session, link):
            page = Page(link)
            for message in some:
                assert page.post("push", message)[0] == 200
            assert session.late == 0  # (what came again was not even looked at)
    held = append.held(tmp_path / "recording.mcap").streams
    ns, value = held["imu"]
    own = np.searchsorted(stamps(recording), ns)
    assert np.array_equal(stamps(recording)[own], ns)
    assert len(ns) >= 600 - 2  # (the last has to wait for its accelerometer)
    assert np.array_equal(value[:, :3], recording.imu.gyro[own])
    np.testing.assert_allclose(value[:, 3:], recording.imu.accel[own], rtol=0, atol=1e-13)
    mag = held["mag"][1]
    np.testing.assert_allclose(mag, recording.streams["mag"].value[: len(mag)], rtol=1e-12)


def test_of_sensor_logger_what_is_no_reading_is_refused(tmp_path, recording):
    good = pushes(recording, False)
    with served(tmp_path) as (session, link):
        page = Page(link)
        assert page.post("push", good[0])[0] == 200
        had = session.recorder.samples

        def bad(**more: Any) -> dict[str, Any]:
            row = {"name": "gyroscope", "time": START_NS, "values": {"x": 0.0, "y": 0.0, "z": 0.0}}
            return {**good[1], "payload": [row | more]}

        for body in (
            b"[", b"[]", {**good[1], "messageId": "1"}, {**good[1], "sessionId": 5},
            {**good[1], "payload": [3]}, bad(time="1"), bad(time=12), bad(values={"x": 1.0}),
            bad(values={"x": float("nan"), "y": 0.0, "z": 0.0}), bad(values=[1, 2, 3]),
            bad(values={"x": 1e9, "y": 0.0, "z": 0.0}),
        ):  # fmt: skip
            assert page.post("push", body)[0] == 400, body
        assert page.post("push", b" " * (4 * 2**20 + 1))[0] == 413
        assert session.recorder.samples == had
        assert page.post("push", good[2])[0] == 200  # (number 1 never came: a gap, and no more)
        assert session.recorder.samples > had


def test_an_accelerometer_with_stamps_of_its_own_comes_to_the_gyros():
    """In pieces of any size as if it had come at once; across a silence nothing is made up."""
    t = np.arange(400)
    gyro = (t * 10_000_000, np.column_stack([t, t, t]).astype(float))
    at = np.arange(330) * 11_000_000 + 3_000_000
    at = at[(at < 1_500_000_000) | (at > 2_200_000_000)]
    accel = (at, np.column_stack([at, 2 * at, 3 * at]) / 1e7)
    whole = Pairing()
    whole.add(gyro, accel)
    once = whole.ready()
    parts, found = Pairing(), []
    for k in range(0, 400, 37):
        own = (at >= k * 10_000_000) & (at < (k + 37) * 10_000_000)
        parts.add((gyro[0][k : k + 37], gyro[1][k : k + 37]), (at[own], accel[1][own]))
        found.append(parts.ready())
    for i in range(3):
        assert np.array_equal(np.concatenate([f[i] for f in found]), once[i])
    np.testing.assert_allclose(once[2][:, 1], 2 * once[0] / 1e7, atol=1e-9)
    inside = (once[0] > 1_510_000_000) & (once[0] < 2_190_000_000)
    assert not inside.any()
    assert whole.late > 60


class Phyphox:
    """The app's remote interface, by its documentation: an experiment that measures since it was
    started, as fast as somebody turns ``now`` on."""

    def __init__(self, recording: Recording, apple: bool = False) -> None:
        self.recording, self.now, self.started, self.name = recording, 0.0, False, "a1b2c3"
        self.brand = "Apple" if apple else "Google"
        self.unit = 9.81 / G if apple else 1.0
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                body = json.dumps(outer.answer(self.path)).encode()
                self.send_response(200)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                return

        self.server = HTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"127.0.0.1:{self.server.server_address[1]}"

    def buffers(self) -> dict[str, tuple[np.ndarray, str]]:
        imu, mag = self.recording.imu, self.recording.streams["mag"]
        out = {}
        sensors = (imu.t, imu.gyro), (imu.t, self.unit * imu.accel), (mag.t, 1e6 * mag.value)
        for stem, (t, value) in zip(("gyr", "acc", "mag"), sensors, strict=True):
            own = t <= self.now
            out[f"{stem}_time"] = (t[own], f"{stem}_time")
            out |= {f"{stem}{a}": (value[own, i], f"{stem}_time") for i, a in enumerate("XYZ")}
        return out

    def answer(self, path: str) -> Any:
        what, _, query = path.partition("?")
        if what == "/config":
            sensors = (("gyroscope", "gyr"), ("accelerometer", "acc"), ("magnetic_field", "mag"))
            inputs = [
                {"source": source, "outputs": [{"x": f"{s}X"}, {"y": f"{s}Y"}, {"z": f"{s}Z"},
                                               {"t": f"{s}_time"}]}
                for source, s in sensors
            ]  # fmt: skip
            return {"title": "own", "inputs": inputs, "buffers": []}
        if what == "/meta":
            return {"deviceBrand": self.brand}
        if what == "/time":
            start = {"event": "START", "experimentTime": 0.0, "systemTime": START_NS / 1e9}
            return [start] if self.started else []
        if what == "/control":
            self.started = True
            return {"result": True}
        assert what == "/get"
        held, found = self.buffers(), {}
        for item in urllib.parse.unquote(query).split("&"):
            name, _, threshold = item.partition("=")
            value, clock = held[name]
            after, _, beside = threshold.partition("|")
            of = held[beside or name][0]
            assert clock == (beside or name)
            new = value[of > float(after)] if self.started else value[:0]
            found[name] = {"size": 0, "updateMode": "partial", "buffer": new.tolist()}
        return {"buffer": found, "status": {"session": self.name, "measuring": self.started,
                                            "timedRun": False, "countDown": 0}}  # fmt: skip


@pytest.fixture(params=[False, True])
def app(request, recording) -> Iterator[Phyphox]:
    made = Phyphox(recording, request.param)
    thread = threading.Thread(target=made.server.serve_forever, args=(0.05,))
    thread.start()
    yield made
    made.server.shutdown()
    made.server.server_close()
    thread.join()


def test_phyphox_is_asked_for_what_is_new(tmp_path, recording, app):
    """It is started, gives each reading once, also after a restart here, and ends when the phone
    is told to stop."""
    session = Session(opened(tmp_path / "recording.mcap"))
    phone = phyphox.found(app.address)
    for app.now in np.arange(0.0, 4.0, 0.35):
        phone.poll(session)
    assert app.started
    session.recorder.close()
    session = Session(opened(tmp_path / "recording.mcap"))
    phone = phyphox.found(app.address)
    for app.now in np.arange(4.0, 6.6, 0.35):
        phone.poll(session)
    assert not phone.ended
    out = session.recording()
    assert out is not None
    assert np.array_equal(out.imu.gyro, recording.imu.gyro)
    np.testing.assert_allclose(out.imu.accel, recording.imu.accel, rtol=1e-14)
    assert np.abs(out.imu.t - recording.imu.t).max() < 2e-9
    assert out.start_ns == START_NS
    mag = out.streams["mag"].value
    np.testing.assert_allclose(mag, recording.streams["mag"].value[: len(mag)], rtol=1e-12)
    app.started = False
    phone.poll(session)
    assert phone.ended
    app.name = "other"
    with pytest.raises(HandcalError, match="another experiment"):
        phone.poll(session)
    session.recorder.close()


def test_where_no_phyphox_is_or_it_lacks_a_sensor_is_said(app, monkeypatch):
    with pytest.raises(InputError, match="remote access"):
        phyphox.found("127.0.0.1:9")
    answer = app.answer
    monkeypatch.setattr(app, "answer", lambda path: (
        {"inputs": answer(path)["inputs"][:1]} if path == "/config" else answer(path)))  # fmt: skip
    with pytest.raises(InputError, match=r"does not record accelerometer"):
        phyphox.found(app.address)


def test_a_recorders_growing_file_is_followed(tmp_path, recording):
    """Byte by byte or all at once, the same comes out; it ends with the file."""
    whole = tmp_path / "whole.mcap"
    write_mcap(recording, whole)
    data, path = whole.read_bytes(), tmp_path / "growing.mcap"
    session = Session(opened(tmp_path / "recording.mcap"))
    source = mcap.growing(path, Options())
    assert source.pull(session)  # (it is not there yet)
    more, seen = True, []
    for end in [4, 8, 700, *range(1000, len(data), 20_000), len(data)]:
        assert more
        path.write_bytes(data[:end])
        more = source.pull(session)
        seen.append(session.recorder.samples)
    assert not more
    assert len(set(seen)) > 3
    has_all(session, recording)
    session.recorder.close()


def test_two_topics_of_a_growing_file_are_joined(tmp_path):
    """Issue 75: RealSense's driver has one for each sensor, the other half zero."""
    (path,) = ros2_bag(tmp_path / "bag", sample(n=300), "MCAP", apart=("/a",)).glob("*.mcap")
    session = Session(opened(tmp_path / "recording.mcap"))
    source = mcap.growing(path, Options())
    while source.pull(session):
        pass
    assert session.recorder.samples == 300
    session.recorder.close()
    np.testing.assert_allclose(
        load(tmp_path / "recording.mcap").imu.accel, sample(n=300).imu.accel, atol=1e-12
    )


def test_what_is_no_growing_recording_is_said(tmp_path):
    path = tmp_path / "x.mcap"
    path.write_bytes(b"no MCAP at all, but long enough to see that")
    session = Session(opened(tmp_path / "recording.mcap"))
    with pytest.raises(InputError, match="no MCAP file"):
        mcap.growing(path, Options()).pull(session)
    session.recorder.close()


def test_clocks_are_related_and_not_mixed():
    from handcal.live.clocks import Clocks

    rng = np.random.default_rng(0)
    clocks = Clocks()
    for t in np.arange(0.0, 300.0, 0.25):
        delay = 0.02 + rng.exponential(0.05)
        arrived = (1.0 - 40e-6) * t + 5.0 + delay  # (the sender runs 40 ppm fast)
        clocks.heard(round(t * 1e9), round(arrived * 1e9))
    assert clocks.offset_s == pytest.approx(5.02, abs=0.015)
    assert clocks.ppm is not None
    rate, sigma = clocks.ppm
    assert abs(rate - 40.0) < 4.0 * sigma < 60.0
    assert "behind" in clocks.sentence


@contextmanager
def foxglove_server(recording: Recording, protocol: str) -> Iterator[str]:
    """A server of the Foxglove WebSocket protocol: a picture's channel, and a recording's."""
    from aiohttp import web

    names = ("imu", *recording.streams)
    series = {"imu": (stamps(recording), np.hstack([recording.imu.gyro, recording.imu.accel]))}
    for name, s in recording.streams.items():
        series[name] = (START_NS + np.rint(s.t * 1e9).astype(np.int64), s.value)

    async def serve(request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse(protocols=(protocol,))
        await socket.prepare(request)
        await socket.send_json({"op": "serverInfo", "name": "x", "capabilities": []})
        channels = [{"id": 7, "topic": "/camera", "encoding": "cdr", "schema": "",
                     "schemaName": "sensor_msgs/msg/Image"}]  # fmt: skip
        channels += [
            {"id": 10 + k, "topic": STREAMS[n].topic, "encoding": "cdr", "schema": "",
             "schemaName": STREAMS[n].message.schema}
            for k, n in enumerate(names)
        ]  # fmt: skip
        await socket.send_json({"op": "advertise", "channels": channels})
        asked = await socket.receive_json()
        assert asked["op"] == "subscribe"
        of = {names[s["channelId"] - 10]: s["id"] for s in asked["subscriptions"]}
        assert set(of) == set(names)
        rows = sorted((int(ns), n, k) for n in names for k, ns in enumerate(series[n][0]))
        encoded = {n: messages(n, *series[n]) for n in names}
        await socket.send_bytes(b"\x01")
        for ns, n, k in rows:
            await socket.send_bytes(struct.pack("<BIQ", 1, of[n], ns) + encoded[n][k].tobytes())
        await socket.close()
        return socket

    async def begin() -> web.AppRunner:
        app = web.Application()
        app.router.add_get("/", serve)
        runner = web.AppRunner(app)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        return runner

    with running(begin) as runner:
        yield f"127.0.0.1:{runner.addresses[0][1]}"


def test_a_foxglove_websocket_is_listened_to(tmp_path, recording):
    session = Session(opened(tmp_path / "recording.mcap"))
    with foxglove_server(recording, "foxglove.websocket.v1") as address:
        source = foxglove.connected(address, Options())
        while source.pull(session):
            time.sleep(0.02)
    has_all(session, recording)
    session.recorder.close()
    with foxglove_server(recording, "chat") as address, pytest.raises(InputError, match="Foxglove"):
        foxglove.connected(address, Options())
    with pytest.raises(InputError, match="No Foxglove"):
        foxglove.connected("127.0.0.1:9", Options())
