"""A fleet: what becomes of a recording, what is kept of it, what is refused."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path

import pytest
import schemas
from typer.testing import CliRunner

from handcal.commands._app import app
from handcal.device import priors
from handcal.fleet import dataset, store
from handcal.fleet.record import Options, Source, digest, key
from handcal.fleet.results import write_all
from handcal.fleet.run import run
from handcal.fleet.sources import found, joined, listed
from handcal.fleet.supervise import TRIES, Local, of_this_process, supervised_all
from handcal.types import InputError
from handcal.workers import AHEAD, Workers, opened

HERE = Path(__file__).parent
WORK = "fleet_stub:work"


@pytest.fixture(autouse=True)
def _stub_can_be_imported(monkeypatch):
    # (its process begins with -P, so what is not installed has to be named)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), *sys.path]))


def options(deadline=20.0, memory=2_000_000_000):
    return Options(deadline, memory, work=WORK)


def files(folder, **texts):
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        (folder / f"{name}.csv").write_text(text)
    return [Source(str(p), "m", p.stem) for p in sorted(folder.iterdir())]


def made(sources, folder, chosen=None, jobs=2):
    """What is kept after a run, by name of the file."""
    place = store.opened(folder)
    with opened("local", jobs, Local) as workers:
        members = run(sources, place, workers, chosen or options(), lambda _: None, lambda _: None)
    return {Path(m.source.place).stem: place.record(m.key) for m in members}, members, place


def test_whatever_becomes_of_a_recording_is_a_row_with_the_reason(tmp_path):
    sources = files(tmp_path / "in", good="fine 0.01", refused="refuse", bug="bug", dead="die",
                    crash="segfault", hung="hang", large="eat")  # fmt: skip
    # (only what never ends has a short deadline: a busy machine may keep the others waiting)
    endless = [s for s in sources if Path(s.place).stem == "hung"]
    others = [s for s in sources if s not in endless]
    out = tmp_path / "out"
    records, members, place = made(others, out, options(120.0, 600_000_000))
    late, ended, _ = made(endless, out, options(2.0, 600_000_000))
    records, members = records | late, [*members, *ended]
    told = {name: r["status"] for name, r in records.items()}
    assert told == {"good": "done", "refused": "failed", "bug": "crashed", "dead": "killed",
                    "crash": "crashed", "hung": "timed_out", "large": "out_of_memory"}  # fmt: skip
    assert records["refused"]["reason"] == "refused.csv is not a recording."
    assert "a bug of ours" in records["bug"]["reason"]
    assert "SIGSEGV" in records["crash"]["reason"]
    assert "after 2 s" in records["hung"]["reason"]
    assert "600 MB" in records["large"]["reason"]
    assert records["dead"]["tries"] == TRIES
    assert records["large"]["peak"] > 600_000_000
    for record in records.values():
        schemas.check(record)
    written = write_all(members, place)
    assert (written.done, written.failed) == (1, 6)
    from pyarrow import parquet

    table = parquet.read_table(tmp_path / "out/data/recordings").to_pylist()
    assert {Path(r["path"]).stem: r["status"] for r in table} == told
    assert {r["model"] for r in table} == {"m"}
    (value,) = parquet.read_table(tmp_path / "out/data/parameters").to_pylist()
    assert (value["effect"], value["value"], value["sigma"]) == ("gyro_scale", 0.01, 0.001)
    about = parquet.read_schema(next((tmp_path / "out/data/recordings").rglob("*.parquet")))
    assert about.metadata[b"handcal.schema"] == b"handcal/fleet-data/1/recordings"
    assert "a bug of ours" in (tmp_path / "out/fleet.html").read_text()
    schemas.check(json.loads((tmp_path / "out/fleet.json").read_text()))


def test_what_is_kept_is_not_made_again_and_what_was_killed_is(tmp_path, monkeypatch):
    marks = tmp_path / "marks"
    marks.mkdir()
    monkeypatch.setenv("FLEET_MARKS", str(marks))
    sources = files(tmp_path / "in", a="fine 1", b="fine 2", dead="die", hung="hang")
    first, _, _ = made(sources, tmp_path / "out", options(2.0))
    count = {p.stem: len(p.read_text().splitlines()) for p in marks.iterdir()}
    assert count == {"a": 1, "b": 1, "dead": TRIES, "hung": 1}
    again, _, _ = made(sources, tmp_path / "out", options(2.0))
    assert again["a"] == first["a"]
    made(sources, tmp_path / "out", options(3.0))  # (a further deadline is another chance)
    (tmp_path / "in/b.csv").write_text("fine 3")  # other readings
    made(sources, tmp_path / "out", options(3.0))
    count = {p.stem: len(p.read_text().splitlines()) for p in marks.iterdir()}
    assert count == {"a": 1, "b": 2, "dead": 4 * TRIES, "hung": 2}


@pytest.mark.prove
def test_a_run_that_is_killed_loses_only_what_was_under_way(tmp_path):
    sources = files(tmp_path / "in", **{f"r{i}": f"slow {i}" for i in range(12)})
    out = tmp_path / "out"
    code = (
        "import sys; from pathlib import Path; import test_fleet as t; from handcal.fleet.record "
        "import Source; t.made([Source(str(p), 'm', p.stem) for p in "
        "sorted(Path(sys.argv[1]).iterdir())], Path(sys.argv[2]))"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "in"), str(out)]
    process = subprocess.Popen(command)
    began = time.monotonic()
    while len(list(out.glob("recordings/*.json"))) < 3 and time.monotonic() - began < 30:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    time.sleep(0.5)  # (nobody goes on: the watchers have seen that nobody asks any more)
    kept = {p.name: p.stat().st_mtime_ns for p in out.glob("recordings/*.json")}
    assert 3 <= len(kept) < 12
    records, _, _ = made(sources, out)
    after = {p.name: p.stat().st_mtime_ns for p in out.glob("recordings/*.json")}
    assert {r["told"][0]["value"] for r in records.values()} == set(map(float, range(12)))
    assert {k: after[k] for k in kept} == kept


class Parcels(Executor):
    """Answers at once, that each recording took so many seconds; every so many one is lost."""

    def __init__(self, seconds, lost):
        self.seconds, self.lost, self.sizes = seconds, lost, []

    def submit(self, fn, requests):
        assert fn is supervised_all
        self.sizes.append(len(requests))
        future = Future()
        if len(self.sizes) % self.lost == 0:
            future.set_exception(BrokenExecutor("lost"))
            return future
        answer = {"status": "failed", "reason": "", "tries": 1, "seconds": self.seconds, "peak": 0}
        future.set_result([answer] * len(requests))
        return future


@pytest.mark.parametrize(("seconds", "together", "largest"), [
    (0.01, 16, 16), (10.0, 16, 3), (100.0, 16, 1), (0.01, 1, 1)
])  # fmt: skip
def test_short_recordings_travel_together_and_none_is_lost(tmp_path, seconds, together, largest):
    sources = [Source(f"stub://{i}", "m", f"d{i}", identity=f"stub-{i}") for i in range(200)]
    engine = Parcels(seconds, 7)
    workers = Workers(lambda: engine, 1, together=together)
    place = store.opened(tmp_path / "out")
    members = run(sources, place, workers, options(), lambda _: None, lambda _: None)
    assert [m.source for m in members] == sources
    assert all(place.record(m.key)["status"] == "failed" for m in members)
    # (so far ahead nothing is known of how long they take, and at the end few are left)
    assert engine.sizes[:AHEAD] == [1] * AHEAD
    assert engine.sizes[-1] == 1
    assert max(engine.sizes) == largest


def test_the_same_readings_count_once(tmp_path):
    sources = files(tmp_path / "in", a="fine 1", b="fine 1")
    _, members, place = made(sources, tmp_path / "out")
    written = write_all(members, place)
    assert (written.done, written.failed) == (1, 1)
    assert "which count once" in written.fleet.failures[0][2]


def test_a_recording_that_tells_nothing_of_its_model_is_explained_and_named(tmp_path):
    """Two phones that `explain` explains have no fit with what every device has."""
    sources = files(tmp_path / "in", a="fine 0.01", odd="untold 0.5", wrong="refuse")
    records, members, place = made(sources, tmp_path / "out")
    schemas.check(records["odd"])
    written = write_all(members, place)
    assert (written.done, written.failed) == (2, 1)
    assert any(s.startswith("odd.csv is explained") for s in written.said)
    assert any(s.startswith("wrong.csv: ") for s in written.said)
    document = json.loads((tmp_path / "out/fleet.json").read_text())
    schemas.check(document)
    assert [Path(u["path"]).name for u in document["untold"]] == ["odd.csv"]
    assert document["verdicts"] == {"explained": 2}
    assert [m["recordings"] for m in document["models"]] == [1]
    assert "odd.csv" in (tmp_path / "out/fleet.html").read_text()


def test_priors_are_of_devices_and_of_no_room_or_hand(tmp_path):
    values = (-0.003, -0.0015, 0.0005, 0.001, 0.0022, 0.0035)
    sources = files(tmp_path / "in", **{f"d{i}": f"worn {v}" for i, v in enumerate(values)})
    _, members, place = made(sources, tmp_path / "out")
    write_all(members, place)
    (model,) = json.loads((tmp_path / "out/fleet.json").read_text())["models"]
    of = {p["effect"]: p["of"] for p in model["populations"]}
    assert of == {"gyro_scale": "device", "lever_arm": "occasion", "mag_hard_iron": "occasion",
                  "mag_gradient": "occasion"}  # fmt: skip
    assert {p["effect"] for p in model["populations"] if p["told"]} == set(of)
    learned = priors.read(tmp_path / "out/priors.toml").models["m"]
    assert set(learned) == {("gyro_scale", "x")}


def test_a_key_depends_on_bytes_version_and_options_but_not_on_limits(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("fine")
    one = key(digest(path), "1", options(), None)
    assert key(digest(path), "1", options(deadline=3.0), None) == one
    assert key(digest(path), "2", options(), None) != one
    assert key(digest(path), "1", Options(20.0, 1, 5.0, work=WORK), None) != one
    assert key(digest(path), "1", options(), {"mean": [1.0]}) != one
    path.write_text("other")
    assert key(digest(path), "1", options(), None) != one


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("device,model\n", "first line with path"),
        ("path,device\nnone.csv,d\n", "line 2: none.csv does not exist"),
        (f"path,device\n{'a' * 5000},d\n", "line 2: a+ does not exist"),
        ("path,device\na\0b,d\n", "line 2: a\0b does not exist"),
        ("path,device\na.csv,d\na.csv,e\n", "line 3: a.csv is listed twice"),
        ("path,device,model\na.csv,d,x\nb.csv,d,y\n", "device 'd' is of model 'x' and of model"),
        ("path,started\na.csv,yesterday\n", "line 2: started is 'yesterday'"),
        ("path,device\na.csv\n", "line 2: another number of fields"),
        ("path\n", "lists no recording"),
    ],
)
def test_a_wrong_manifest_is_a_sentence_before_anything_runs(tmp_path, text, said):
    files(tmp_path, a="fine", b="fine")
    manifest = tmp_path / "manifest.txt"
    manifest.write_text(text)
    with pytest.raises(InputError, match=said):
        listed(manifest)
    result = CliRunner().invoke(
        app, ["fleet", "--manifest", str(manifest), "--out", str(tmp_path / "out")]
    )
    assert result.exit_code == 2
    assert not (tmp_path / "out").exists()


def test_a_manifest_has_to_know_every_recording(tmp_path):
    files(tmp_path, a="fine", b="fine")
    (tmp_path / "m.list").write_text("path,device,model,site\na.csv,d,x,here\n")
    rows = listed(tmp_path / "m.list")
    paths, others = found([str(tmp_path / "*.csv")])
    assert others == []
    with pytest.raises(InputError, match=r"b\.csv is not in the manifest"):
        joined(paths, rows, "model")
    assert joined(paths[:1], rows, "site")[0].model == "here"
    with pytest.raises(InputError, match="no such column"):
        joined(paths[:1], rows, "moon")
    # what a fleet wrote into a folder that it reads is no recording of the next run
    inside = tmp_path / "fleet/data/recordings/model=x"
    inside.mkdir(parents=True)
    (inside / "part-0.parquet").write_text("rows")
    paths, others = found([str(tmp_path)], str(tmp_path / "fleet"))
    assert [Path(s.place).name for s in paths] == ["a.csv", "b.csv"]
    assert [Path(p).name for p in others] == ["m.list"]
    with pytest.raises(InputError, match="no such file"):
        found([str(tmp_path / "*.bag")])


def test_a_folder_with_one_recording_that_is_a_folder_is_many(tmp_path):
    """Formats look for a recording within a folder; beside it there are others."""
    app = tmp_path / "all/app"
    app.mkdir(parents=True)
    for name in ("Gyroscope", "Accelerometer", "Gravity"):
        (app / f"{name}.csv").write_text("time,seconds_elapsed,z,y,x\n1,0,0,0,1\n2,0.01,0,0,1\n")
    assert [Path(s.place).name for s in found([str(app)])[0]] == ["app"]
    assert [Path(s.place).name for s in found([str(tmp_path / "all")])[0]] == ["all"]
    (tmp_path / "all/one.mcap").write_text("x")
    assert [Path(s.place).name for s in found([str(tmp_path / "all")])[0]] == ["app", "one.mcap"]
    shutil.copytree(app, tmp_path / "all/second")
    (tmp_path / "all/one.mcap").unlink()
    assert [Path(s.place).name for s in found([str(tmp_path / "all")])[0]] == ["app", "second"]


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="something else"):
        store.opened(tmp_path)
    assert json.loads(json.dumps(dataset.COLUMNS))  # (documented, every column)


def test_a_dask_cluster_keeps_the_same(tmp_path):
    distributed = pytest.importorskip(
        "distributed", reason="dask is not installed: pip install '.[dask]'"
    )
    sources = files(tmp_path / "in", a="fine 1", dead="die", refused="refuse")
    here, _, _ = made(sources, tmp_path / "here")
    place = store.opened(tmp_path / "there")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, host="127.0.0.1",
        dashboard_address=None, protocol="tcp", silence_logs=50,
    ) as cluster:  # fmt: skip
        where = cluster.scheduler_address.replace("tcp://", "dask://")
        with opened(where, 1, Local) as workers:
            members = run(sources, place, workers, options(), lambda _: None, lambda _: None)
        of_this_process().end()
        of_this_process().forget()
        of_this_process.cache_clear()
    for m in members:
        there = place.record(m.key)
        assert [there[k] for k in ("status", "reason")] == [
            here[Path(m.source.place).stem][k] for k in ("status", "reason")
        ]
