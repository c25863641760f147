"""Dask's workers are killed one after the other and its scheduler once, while real recordings are
explained: in the end the data set is that of a run that nobody disturbed, row for row.

Some minutes: `pytest -m prove tests/test_fleet_killed.py`.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from handcal.fleet import store
from handcal.fleet.record import Options, Source
from handcal.fleet.results import write_all
from handcal.fleet.run import run
from handcal.fleet.supervise import Local
from handcal.workers import WorkersDied, opened
from handcal_sim.mcap_writer import write
from handcal_sim.prove.fleet_world import devices, recorded

RECORDINGS, WORKERS, EVERY_S = 16, 3, 30.0
# What depends on when and where it was computed.
PASSING = ("seconds", "peak_bytes")


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    import numpy as np

    folder = tmp_path_factory.mktemp("recordings")
    made = devices(8, np.random.default_rng(0))
    out = []
    for i in range(RECORDINGS):
        path = folder / f"r{i:02d}.mcap"
        write(recorded(made[i % len(made)], i), path, truth=False)
        out.append(Source(str(path), "m", made[i % len(made)].name))
    return out


@contextmanager
def scheduler(port):
    process = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1",
         "--port", str(port), "--no-dashboard"], stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        time.sleep(4.0)
        yield process
    finally:
        process.kill()
        process.wait()


class Workers:
    """So many at a time; one that is killed is followed by another."""

    def __init__(self, port):
        self.port, self.killed, self.over = port, 0, threading.Event()
        self.processes = [self.new() for _ in range(WORKERS)]
        self.thread = threading.Thread(target=self.kill_one_after_the_other)
        self.thread.start()

    def new(self):
        return subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny",
             "--no-dashboard", "--host", "127.0.0.1", f"tcp://127.0.0.1:{self.port}"],
            stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def kill_one_after_the_other(self):
        while not self.over.wait(EVERY_S):
            at = self.killed % WORKERS
            os.kill(self.processes[at].pid, signal.SIGKILL)
            self.processes[at].wait()
            self.killed += 1
            self.processes[at] = self.new()

    def end(self):
        self.over.set()
        self.thread.join()
        for process in self.processes:
            process.kill()
            process.wait()


def asked(sources, where, folder, say=lambda _: None):
    place = store.opened(folder)
    with opened(where, WORKERS, Local) as workers:
        members = run(sources, place, workers, Options(600.0, 4_000_000_000), lambda _: None, say)
    write_all(members, place)


def table(folder: Path, kind):
    from pyarrow import parquet

    rows = parquet.read_table(folder / "data" / kind).to_pylist()
    return [{k: v for k, v in row.items() if k not in PASSING} for row in rows]


@pytest.mark.prove
def test_killed_workers_and_a_killed_scheduler_change_no_row(sources, tmp_path):
    pytest.importorskip("distributed", reason="dask is not installed: pip install '.[dask]'")
    asked(sources, "local", tmp_path / "quiet")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    where = f"dask://127.0.0.1:{port}"
    killed, disturbed = 0, tmp_path / "disturbed"
    with scheduler(port) as first:
        workers = Workers(port)
        time.sleep(6.0)

        def at_half(progress):
            if progress.finished >= RECORDINGS // 2:
                first.kill()

        try:
            with pytest.raises(WorkersDied, match="scheduler is gone"):
                asked(sources, where, disturbed, at_half)
        finally:
            workers.end()
            killed += workers.killed
    kept = len(list((disturbed / "recordings").glob("*.json")))
    assert RECORDINGS // 2 <= kept < RECORDINGS
    with scheduler(port):
        workers = Workers(port)
        time.sleep(6.0)
        try:
            asked(sources, where, disturbed)
        finally:
            workers.end()
            killed += workers.killed
    assert killed >= 2
    print(f"{killed} workers killed, {kept} recordings kept before the scheduler was")
    for kind in ("recordings", "parameters"):
        assert table(disturbed, kind) == table(tmp_path / "quiet", kind)
