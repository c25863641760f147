"""Recordings and results at addresses."""

from __future__ import annotations

import json
import os
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from handcal.commands._app import app
from handcal.fleet import remote, store
from handcal.fleet.record import Options, Source, shown
from handcal.fleet.results import write_all
from handcal.fleet.run import run
from handcal.fleet.sources import found, joined, listed
from handcal.fleet.supervise import Local
from handcal.types import InputError
from handcal.workers import opened

fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed: pip install fsspec")
HERE = Path(__file__).parent
OPTIONS = Options(60.0, 2_000_000_000, work="fleet_stub:work")


@pytest.fixture(autouse=True)
def _stub_can_be_imported(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), *sys.path]))


@pytest.fixture
def web(tmp_path):
    """A web server of this machine, its folder, and how often each file was asked for."""
    folder, asked = tmp_path / "web", list[str]()
    folder.mkdir()

    class Handler(SimpleHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            super().do_GET()

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}", folder, asked
    server.shutdown()
    server.server_close()


@pytest.fixture
def memory():
    """An empty folder of this process's memory, as an address."""
    storage = fsspec.filesystem("memory")
    storage.store.clear()
    yield "memory://bucket/fleet"
    storage.store.clear()


def made(sources, place):
    """What is kept after a run, by name of the file, and the run's result."""
    with store.opened_at(str(place)) as kept:
        with opened("local", 2, Local) as workers:
            members = run(sources, kept, workers, OPTIONS, lambda _: None, lambda _: None)
        records = {Path(m.source.place).stem: kept.record(m.key) for m in members}
        return records, write_all(members, kept)


def test_what_a_web_server_has_is_read_once_and_again_when_it_changes(web, tmp_path):
    where, folder, asked = web
    (folder / "a.csv").write_text("fine 1")
    (folder / "b.csv").write_text("fine 2")
    (folder / "notes.md").write_text("no recording")
    sources, others = found([f"{where}/"])
    assert [Path(s.place).name for s in sources] == ["a.csv", "b.csv"]
    assert [Path(o).name for o in others] == ["notes.md"]
    del asked[:]
    records, written = made(sources, tmp_path / "out")
    assert {n: r["told"][0]["value"] for n, r in records.items()} == {"a": 1.0, "b": 2.0}
    assert (written.done, written.failed) == (2, 0)
    assert sorted(asked) == ["/a.csv", "/b.csv"]
    made(found([f"{where}/"])[0], tmp_path / "out")
    assert sorted(a for a in asked if a != "/") == ["/a.csv", "/b.csv"]
    (folder / "b.csv").write_text("fine 34")
    records, _ = made(found([f"{where}/"])[0], tmp_path / "out")
    assert records["b"]["told"][0]["value"] == 34.0
    assert sorted(a for a in asked if a != "/") == ["/a.csv", "/b.csv", "/b.csv"]


def test_what_is_gone_is_a_row_and_tried_again(web, tmp_path):
    where, folder, _ = web
    (folder / "a.csv").write_text("fine 1")
    (source,) = found([f"{where}/a.csv"])[0]
    away = Source("http://127.0.0.1:9/b.csv", identity="0" * 64)  # (the port of "discard": nobody)
    (folder / "a.csv").rename(folder / "c.csv")
    records, written = made([source, away], tmp_path / "out")
    assert (written.done, written.failed) == (0, 2)
    assert {r["status"] for r in records.values()} == {"unreachable"}
    assert "there is nothing" in records["a"]["reason"]
    (folder / "c.csv").rename(folder / "a.csv")
    records, _ = made([source], tmp_path / "out")
    assert records["a"]["status"] == "done"


def test_the_same_readings_at_two_addresses_count_once(web, tmp_path):
    where, folder, _ = web
    for name in "ab":
        (folder / f"{name}.csv").write_text("fine 1")
    _, written = made(found([f"{where}/a.csv", f"{where}/b.csv"])[0], tmp_path / "out")
    assert (written.done, written.failed) == (1, 1)
    assert "which count once" in written.fleet.failures[0][2]


def test_results_go_to_an_address_and_go_on_from_there(web, memory):
    where, folder, asked = web
    (folder / "a.csv").write_text("fine 1")
    sources, _ = found([f"{where}/a.csv"])
    made(sources, memory)
    there = {p.removeprefix("/bucket/fleet/") for p in fsspec.filesystem("memory").find("/bucket")}
    assert {"fleet.html", "fleet.json", "priors.toml"} <= there
    assert any(p.startswith("data/recordings/model=") for p in there)
    assert sum(p.startswith("recordings/") for p in there) == 1
    assert sum(p.startswith("explanations/") for p in there) == 1
    count = len(asked)
    records, written = made(sources, memory)  # (another folder of this machine, the same address)
    assert len(asked) == count
    assert written.done == 1
    assert records["a"]["told"][0]["value"] == 1.0
    (renamed,) = joined(sources, [Source(sources[0].place, "other", "d")], "model")
    made([renamed], memory)
    there = fsspec.filesystem("memory").find("/bucket/fleet/data/recordings")
    assert ["model=other" in p for p in there] == [True]
    with fsspec.open("memory://bucket/mine/notes.md", "w") as file:
        file.write("mine")
    with pytest.raises(InputError, match="something else"), store.opened_at("memory://bucket/mine"):
        pass


def test_a_manifest_may_name_addresses(web, tmp_path):
    where, folder, _ = web
    (folder / "a.csv").write_text("fine 1")
    (tmp_path / "m.txt").write_text(f"path,device,model\n{where}/a.csv?key=secret,d,x\n")
    (row,) = listed(tmp_path / "m.txt")
    assert (row.device, row.model, row.shown) == ("d", "x", f"{where}/a.csv")
    assert row.identity
    (tmp_path / "m.txt").write_text(f"path,device,model\n{where}/none.csv,d,x\n")
    with pytest.raises(InputError, match="there is nothing"):
        listed(tmp_path / "m.txt")


def test_secrets_of_an_address_are_not_shown():
    assert shown("https://me:pass@host:8/a/b.mcap?X-Signature=1#2") == "https://host:8/a/b.mcap"
    assert shown("/a/b?.mcap") == "/a/b?.mcap"


@pytest.mark.parametrize(
    ("address", "said"),
    [("nosuch://x/a.csv", "Protocol not known"), ("http://127.0.0.1:9/a.csv", "there is nothing")],
)
def test_an_address_that_cannot_be_read_is_a_sentence(address, said, tmp_path):
    from typer.testing import CliRunner

    with pytest.raises(InputError, match=said):
        remote.found(address)
    result = CliRunner().invoke(app, ["fleet", address, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2


@pytest.mark.prove
def test_a_server_that_speaks_s3(monkeypatch):
    """Listed, read in parts, results written there too, and gone on with."""
    pytest.importorskip("s3fs", reason="s3fs is not installed: pip install s3fs")
    reason = "pip install 'moto[s3]' flask flask-cors"
    moto = pytest.importorskip("moto.server", reason=reason, exc_type=ImportError)
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    try:
        host, port = server.get_host_and_port()
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            monkeypatch.setenv(name, "any")
        storage = fsspec.filesystem("s3")
        storage.mkdir("logs")
        storage.pipe_file("logs/day/a.csv", b"fine 1")
        large = b"fine 2".ljust(3 * remote.PART + 7)
        storage.pipe_file("logs/day/b.csv", large)
        storage.pipe_file("logs/day/notes.md", b"none")
        sources, others = found(["s3://logs/day"])
        assert [s.place for s in sources] == ["s3://logs/day/a.csv", "s3://logs/day/b.csv"]
        assert [Path(o).name for o in others] == ["notes.md"]
        assert [s.place for s in found(["s3://logs/*/b.*"])[0]] == ["s3://logs/day/b.csv"]
        with remote.fetched("s3://logs/day/b.csv") as (path, _):
            assert path.read_bytes() == large
        records, written = made(sources, "s3://logs/fleet")
        assert (written.done, written.failed) == (2, 0)
        assert {n: r["told"][0]["value"] for n, r in records.items()} == {"a": 1.0, "b": 2.0}
        kept = {p: storage.info(p)["LastModified"] for p in storage.find("logs/fleet/recordings")}
        assert len(kept) == 2
        made(sources, "s3://logs/fleet")
        storage.invalidate_cache()
        assert kept == {p: storage.info(p)["LastModified"] for p in kept}
        assert json.loads(storage.cat_file("logs/fleet/fleet.json"))
    finally:
        server.stop()
