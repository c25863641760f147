"""What a fleet costs beside its explanations: `python scripts/fleet_scale.py --recordings 100000`.

Every recording is a stand-in that answers at once with what one real recording told, and all that
is kept of it is really written. Printed at ten moments: processor time and memory of the one who
asks and, with --executor dask, of Dask's scheduler, which is begun here with --workers workers;
at the end bytes on disk, and what a million recordings of so many --seconds each would cost.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from handcal.fleet.work import explained  # (so that its process is as large as a real one)

MILLION = 1_000_000


def work(request: dict[str, object]) -> dict[str, object]:
    """The stand-in: what the template told, under another path."""
    told = json.loads(Path(os.environ["FLEET_TEMPLATE"]).read_text("utf-8"))
    told["recording"]["path"] = request["path"]
    return told | {"fetched": None}


def template(path: Path) -> float:
    """What one real recording tells, and how long that took, s of processor time."""
    from handcal_sim import simulate
    from handcal_sim.mcap_writer import write

    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "one.mcap"
        write(simulate("free-hand", seed=0, duration_s=20.0), recording, truth=False)
        request = {"path": str(recording), "budget": None, "prior": None}
        explained(request)  # (what has to be compiled)
        began = time.process_time()
        told = explained(request)
        took = time.process_time() - began
    path.write_text(json.dumps(told), encoding="utf-8")
    return took


def used(process: int) -> tuple[float, float]:
    """Processor time, s, and memory, MB, of a process."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    ticks = os.sysconf("SC_CLK_TCK")
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return (int(fields[11]) + int(fields[12])) / ticks, pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@contextmanager
def cluster(workers: int) -> Iterator[tuple[str, int]]:
    """A scheduler and its workers on this machine: its address and process."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    here = ["--no-dashboard", "--host", "127.0.0.1"]
    dask = [sys.executable, "-m"]
    scheduler = subprocess.Popen(
        [*dask, "distributed.cli.dask_scheduler", *here, "--port", str(port)],
        stderr=subprocess.DEVNULL,
    )
    address = f"127.0.0.1:{port}"
    others = [
        subprocess.Popen([*dask, "distributed.cli.dask_worker", *here, "--nthreads", "1",
                          "--no-nanny", f"tcp://{address}"], stderr=subprocess.DEVNULL)
        for _ in range(workers)
    ]  # fmt: skip
    try:
        time.sleep(5.0)
        yield f"dask://{address}", scheduler.pid
    finally:
        for process in (*others, scheduler):
            process.terminate()
            process.wait()


def ran(n: int, where: str, workers: int, scheduler: int | None, out: Path) -> list[list[float]]:
    """Rows at ten moments: finished, s on the clock, processor s and MB of this process, and of
    the scheduler."""
    from handcal.fleet import store
    from handcal.fleet.record import Options, Source
    from handcal.fleet.run import Progress, run
    from handcal.fleet.supervise import Local
    from handcal.workers import opened

    sources = [Source(f"stub://{i}", "m", f"d{i // 10}", identity=f"stub-{i}") for i in range(n)]
    options = Options(60.0, 2_000_000_000, work="fleet_scale:work")
    rows: list[list[float]] = []
    began, at_start = time.monotonic(), used(os.getpid())[0]

    def say(p: Progress) -> None:
        if p.finished * 10 >= (len(rows) + 1) * n:
            own = used(os.getpid())
            row = [p.finished, time.monotonic() - began, own[0] - at_start, own[1]]
            rows.append(row + (list(used(scheduler)) if scheduler else []))
            print("  ".join(f"{x:.5g}" for x in rows[-1]), flush=True)

    with opened(where, workers, Local) as engine:
        run(sources, store.opened(out), engine, options, lambda _: None, say)
    return rows


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--recordings", type=int, default=1000)
    parser.add_argument("--executor", choices=["local", "dask"], default="local")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--seconds", type=float, help="processor s of a recording; else measured")
    asked = parser.parse_args()
    paths = [str(Path(__file__).resolve().parent), *sys.path]
    os.environ["PYTHONPATH"] = os.pathsep.join(p for p in paths if p)
    with tempfile.TemporaryDirectory(prefix="handcal-scale-") as folder:
        os.environ["FLEET_TEMPLATE"] = str(Path(folder) / "template.json")
        measured = template(Path(os.environ["FLEET_TEMPLATE"]))
        print("finished, s, own processor s and MB", end="")
        print(", the scheduler's" if asked.executor == "dask" else "")
        out, n = Path(folder) / "out", asked.recordings
        if asked.executor == "dask":
            with cluster(asked.workers) as (where, scheduler):
                rows = ran(n, where, asked.workers, scheduler, out)
        else:
            rows = ran(n, "local", asked.workers, None, out)
        size = sum(p.stat().st_size for p in out.rglob("*") if p.is_file())
    told(rows, n, size, asked.seconds or measured)
    return 0


def told(rows: list[list[float]], n: int, size: float, seconds: float) -> None:
    """What a recording and what a million cost."""
    first, last = rows[0], rows[-1]
    print(f"own processor time, ms a recording: {1e3 * last[2] / n:.2f}")
    print(f"own memory, MB, at a tenth and at the end: {first[3]:.0f}, {last[3]:.0f}")
    if len(last) > 4:
        spent = (last[4] - first[4]) / (last[0] - first[0])
        print(f"scheduler's processor time, ms a recording: {1e3 * spent:.2f}")
        print(f"scheduler's memory, MB: {first[5]:.0f}, {last[5]:.0f}")
    print(f"on disk, kB a recording: {size / n / 1e3:.1f}")
    print(
        f"a million, of {seconds:.1f} processor s each: {MILLION * seconds / 3600:.0f} core hours "
        f"(the one who asks: {MILLION * last[2] / n / 3600:.1f}), {MILLION * size / n / 1e9:.0f} GB"
    )


if __name__ == "__main__":
    sys.exit(main())
