"""The Rerun recording read back, and the viewer seen from outside."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import rerun as rr
from fake_result import fake_frames, fake_result
from rerun.chunk import RrdReader

from handcal.show import dashboard, frames
from handcal.show.viewer import binary, require_display, viewer
from handcal.types import HandcalError, InputError


def entities(path: Path) -> dict[str, int]:
    """Rows on the timeline by entity."""
    rows: dict[str, int] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if dashboard.TIMELINE in chunk.timeline_names:
            rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    return rows


def test_a_saved_result_reads_back(tmp_path):
    result = fake_result()
    dashboard.save_rrd(result, tmp_path / "x.rrd")
    rows = entities(tmp_path / "x.rrd")
    k = result.history.t.size
    assert rows["/device"] == k
    assert rows["/parameters/gyro_bias/estimate"] == rows["/parameters/gyro_bias/band"] == k
    assert rows["/heading/measured"] == len(result.observed_heading)
    assert rows["/imu/gyro"] == result.recording.imu.t.size
    for kind, i in result.innovations.items():
        assert rows[f"/innovation/{kind}/residual"] == i.t.size
        assert rows[f"/nis/{kind}"] == i.t.size - dashboard.NIS_WINDOW + 1


def test_streaming_fills_the_same_entities_as_saving(tmp_path):
    result = fake_result(extra=False)
    dashboard.save_rrd(result, tmp_path / "saved.rrd")
    plan = frames.layout_of(result)
    with dashboard.file_sink(tmp_path / "streamed.rrd") as sink:
        count = dashboard.stream(fake_frames(result, rate_hz=5), plan, [sink], speed=0)
    streamed = entities(tmp_path / "streamed.rrd")
    assert set(streamed) == set(entities(tmp_path / "saved.rrd"))
    assert streamed["/device"] == count


def test_streaming_keeps_time(tmp_path):
    result = fake_result(extra=False)
    steps = [s for s in fake_frames(result) if s.t < 4.0]
    started = time.monotonic()
    with dashboard.file_sink(tmp_path / "x.rrd") as sink:
        dashboard.stream(steps, frames.layout_of(result), [sink], speed=8)
    assert time.monotonic() - started >= steps[-1].t / 8


def test_a_file_that_cannot_be_written_is_a_sentence(tmp_path):
    with pytest.raises(HandcalError, match="could not be written"):
        dashboard.save_rrd(fake_result(extra=False), tmp_path / "none" / "x.rrd")


def test_without_a_display_a_sentence_names_the_other_ways(monkeypatch):
    if not sys.platform.startswith("linux"):
        pytest.skip("other systems always have a display")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(HandcalError, match=r"--web.*--rrd"):
        require_display()


def test_a_port_in_use_is_a_sentence():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        s.listen()
        with pytest.raises(InputError, match="--port"), viewer(web=True, port=s.getsockname()[1]):
            pass


def listening(pid: int) -> set[str]:
    """Addresses (hexadecimal, as the kernel writes them) that a process listens on."""
    inodes = set()
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = os.readlink(fd)
        except OSError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in inodes:
                found.add(fields[1].split(":")[0])
    return found


@pytest.fixture
def quiet_home(tmp_path, monkeypatch):
    """The viewer's settings in a folder of their own: a first session reports nothing."""
    if not Path("/proc/net/tcp").exists():
        pytest.skip("needs Linux")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


@pytest.mark.usefixtures("quiet_home")
@pytest.mark.parametrize("web", [False, True])
def test_the_viewer_listens_on_this_machine_only_and_ends(web):
    with viewer(web=web, extra=() if web else ("--headless",)) as shown:
        assert (shown.web_url is not None) == web
        assert listening(shown.process.pid) == {"0100007F"}
    assert shown.process.poll() is not None


@pytest.mark.usefixtures("quiet_home")
def test_whatever_the_viewer_asks_the_network_ends_on_this_machine(tmp_path, monkeypatch):
    """It asks its makers for newer versions at the start: only of the proxy it is given."""
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    with socket.socket() as proxy:
        proxy.bind(("127.0.0.1", 0))
        proxy.listen()
        proxy.settimeout(30)
        nowhere = f"http://127.0.0.1:{proxy.getsockname()[1]}"
        monkeypatch.setattr("handcal.show.viewer.NOWHERE", nowhere)
        with viewer(extra=("--headless",)):
            with proxy.accept()[0] as asked:
                assert asked.makefile("rb").readline().startswith(b"CONNECT api.github.com:443")
            time.sleep(3.0)  # statistics are written and sent every two seconds
    assert not list((tmp_path / "data").rglob("analytics/*"))


@pytest.mark.usefixtures("quiet_home")
def test_a_viewer_closed_half_way_ends_the_stream():
    result = fake_result(extra=False)
    with viewer(web=True) as shown:
        threading.Timer(2.0, shown.process.terminate).start()
        steps = iter(fake_frames(result))
        started = time.monotonic()
        plan, sinks = frames.layout_of(result), [rr.GrpcSink(shown.url)]
        dashboard.stream(steps, plan, sinks, watched=lambda: shown.process.poll() is None)
    assert time.monotonic() - started < 15
    assert next(steps, None) is not None


@pytest.mark.usefixtures("quiet_home")
def test_terminating_the_program_ends_its_viewer():
    code = """
import time
from handcal.show.viewer import viewer
with viewer(web=True) as shown:
    print(shown.process.pid, flush=True)
    time.sleep(60)
"""
    program = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    with program:
        pid = int(program.stdout.readline())
        program.send_signal(signal.SIGTERM)
        program.wait(10)
    assert not Path(f"/proc/{pid}").exists()


def test_the_viewer_comes_with_the_package():
    assert binary().exists()
