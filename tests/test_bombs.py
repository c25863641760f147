"""Small files that ask for much, and names that are no names: refused fast, in little memory."""

from __future__ import annotations

import io
import json
import struct
import time
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from fake_result import fake_result
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Header, Schema
from sample_recording import IMU, imu_messages, sample, write_channels
from typer.testing import CliRunner

from handcal.commands._app import app
from handcal.commands._progress import Bar
from handcal.commands._registry import say
from handcal.device import apply
from handcal.explain import model_file
from handcal.recordings.inputs import load
from handcal.show.calibration.report import write_report
from handcal.show.calibration.terminal import print_summary
from handcal.show.console import Terminal
from handcal.types import InputError

if TYPE_CHECKING:
    from playwright.sync_api import Browser

MAGIC = b"\x89MCAP0\r\n"
# As often as the time in which a million numbers are added up.
LOOPS, MEGABYTES = 40.0, 100


def zipped(members: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()


def with_a_size_of_2_60() -> bytes:
    """The sizes in the directory of a zip file are what its writer says."""
    content = bytearray(zipped({"Gyroscope.csv": b"time,x,y,z\n1,0,0,0\n"}))
    at = content.rindex(b"PK\x01\x02")
    content[at + 24 : at + 28] = struct.pack("<I", 0xFFFFFFFE)
    return bytes(content)


def many_channels() -> bytes:
    builder = RecordBuilder()
    Header("ros2", "test").write(builder)
    Schema(id=1, data=b"", encoding="ros2msg", name=IMU).write(builder)
    for n in range(20_000):
        Channel(id=n, topic=f"/{n}", message_encoding="cdr", metadata={}, schema_id=1).write(
            builder
        )
    return MAGIC + builder.end() + MAGIC


BOMBS = {
    "zip.zip": lambda: zipped({"Gyroscope.csv": b"time,x,y,z\n" + bytes(100 * 2**20)}),
    "nested.zip": lambda: zipped({"Gyroscope.csv": zipped({"Gyroscope.csv": bytes(2**24)})}),
    "size.zip": with_a_size_of_2_60,
    "channels.mcap": many_channels,
    "outside.zip": lambda: zipped({"../../Gyroscope.csv": b"time,x,y,z\n1,0,0,0\n"}),
    "record.mcap": lambda: MAGIC + struct.pack("<BQ", 6, 2**60) + bytes(100),
    "deep.json": lambda: b"[" * 10**6,
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused_fast_in_little_memory(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "inner" / "folder"
    folder.mkdir(parents=True)
    path = folder / name
    path.write_bytes(BOMBS[name]())
    started = time.process_time()
    sum(k % 7 for k in range(10**6))
    added_up = time.process_time()
    with pytest.raises(InputError):
        load(path)
    assert time.process_time() - added_up < LOOPS * (added_up - started)
    tracemalloc.start()
    with pytest.raises(InputError):
        load(path)
    peak = tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()
    assert peak < MEGABYTES
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [path], "something was unpacked"


HOSTILE = ("<script>alert(1)</script>", "\x1b[31mred\x1b]0;title\x07", "a\nb: done", "x" * 10_000)


@pytest.mark.parametrize("text", HOSTILE, ids=["html", "ansi", "newline", "long"])
def test_a_hostile_name_in_a_message_is_one_plain_line(
    text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    say(f"{text} does not exist.")
    shown = capsys.readouterr().err
    assert shown.count("\n") == 1
    assert all(c.isprintable() for c in shown.rstrip("\n"))


@pytest.mark.parametrize("text", [*HOSTILE, "[red]x[/red] [/bold]", "\u202egnp"])
def test_a_hostile_name_does_not_command_the_terminal(
    text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out, result = io.StringIO(), fake_result()
    named = replace(result.recording, path=text, warnings=(text,))
    print_summary(replace(result, recording=named, warnings=(text,)), Terminal(file=out))
    bar = Bar(text)
    bar._show()
    bar.describe(text)
    assert bar.shown is not None
    bar.shown.stop()
    shown = out.getvalue() + capsys.readouterr().err
    assert not set(shown) & set("\x1b\x07\u202e")
    assert text[:3] not in ("[re", "xxx") or text[:12] in out.getvalue()


def test_a_hostile_name_is_text_where_a_command_says_what_it_did(tmp_path: Path) -> None:
    """Of `import`, `conceal` and `device add`; all tell it by one function."""
    name = "a\x1b]0;t\x07\n<b>\u202e"
    source, effect = tmp_path / f"{name}.mcap", "gyro_scale=0.01,0,0"
    write_channels(source, [("/imu", IMU, "cdr")], imu_messages(sample(streams=False)))
    for words in (["import", str(source)], ["conceal", str(source), "--effect", effect]):
        done = CliRunner().invoke(app, [*words, "-o", str(tmp_path / f"{name}o.mcap")])
        assert done.exit_code == 0
        assert not set(done.output) & set("\x1b\x07\u202e")
        assert done.stdout.count("\n") == 1


def test_a_hostile_name_in_a_report_is_text(tmp_path: Path) -> None:
    result = fake_result()
    hostile = replace(result.recording, path="<script>alert(1).mcap")
    write_report(replace(result, recording=hostile), tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert" in page


RUNS = ("<script>document.title='ran'</script>", "<img src=x onerror=\"document.title='ran'\">",
        "'\"><svg onload=document.title='ran'>", "</style></title><script>document.title='ran'//",
        "{{ 7 * 7 }}")  # fmt: skip


@pytest.mark.prove
def test_hostile_names_run_no_script_in_a_browser(browser: Browser, tmp_path: Path) -> None:
    name, result = " ".join((*RUNS, *HOSTILE, "$x^{$")), fake_result()
    named = replace(result.recording, path=name, warnings=(name,))
    parameters = tuple(replace(p, unit=" ".join(RUNS)) for p in result.parameters)
    write_report(replace(result, recording=named, parameters=parameters, warnings=(name,)),
                 tmp_path / "r.html")  # fmt: skip
    tab = browser.new_context(offline=True).new_page()
    tab.goto((tmp_path / "r.html").as_uri())
    assert tab.title() != "ran"
    assert "{{ 7 * 7 }}" in tab.inner_text("body")
    assert tab.evaluate("document.querySelectorAll('img[onerror], svg[onload]').length") == 0


@pytest.mark.parametrize("effect", ["__import__('os').system('touch made')", *HOSTILE])
def test_the_json_of_somebody_else_is_data(
    effect: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    parameter = {"effect": effect, "name": "x", "value": 1.0, "sigma": 1.0, "unit": "1"}
    levels = {"latitude": None, "height": 0.0, "noise": {}, "ignore": [], "reference_exact": False}
    document = {
        "schema": "handcal/calibration/1", "parameters": [parameter],
        "model": {"effects": [{"id": effect}], "noise_effects": [], "options": levels,
                  "recordings": [], "levels": []},
    }  # fmt: skip
    path = tmp_path / "theirs.json"
    path.write_text(json.dumps(document))
    for read in (apply.read, model_file.read):
        with pytest.raises(InputError):
            read(path)
    assert [p.name for p in tmp_path.iterdir()] == ["theirs.json"]
