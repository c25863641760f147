"""Where work is done: threads or processes of this machine, or a Dask cluster; one way for all.

Each is an executor of ``concurrent.futures``. Work that was lost with its process is given out
again; what comes of it depends on the task alone, so neither order nor place shows in results.
"""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from concurrent.futures import CancelledError as FutureCancelled
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from typing import Any, TypeVar

from handcal.types import HandcalError, InputError

T = TypeVar("T")
R = TypeVar("R")
# Deaths in a row, without a result in between, until the fault must lie in the work itself.
PATIENCE = 5
LOOK_S = 5.0  # between looks at whether the scheduler is there
# Tasks that are given out for each that runs: a worker never waits, and the memory is bounded.
AHEAD = 4
# Short tasks that travel to Dask's workers together: a message costs its scheduler 4 ms, so one of
# 16 costs 0.25; their results together are a megabyte.
TOGETHER = 16
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class WorkersDied(HandcalError):
    """A sentence for the user: processes died again and again."""


@dataclass(frozen=True)
class Workers:
    """Where tasks are done: a way to an executor, and how many run at once; what is raised for a
    task whose process died; whether there is still anybody to wait for; what to tell people of
    the place (an address of a page, or nothing); and how many short tasks may travel together,
    where each message has its price."""

    start: Callable[[], Executor]
    count: int
    died: tuple[type[BaseException], ...] = (BrokenExecutor,)
    there: Callable[[], bool] = lambda: True
    said: str = ""
    together: int = 1


@contextmanager
def opened(
    where: str, jobs: int, local: Callable[[int], Executor] | None = None
) -> Iterator[Workers]:
    """`local`: so many jobs on this machine, in processes or whatever else ``local`` makes;
    `dask://HOST:PORT`: a Dask cluster. Errors: InputError."""
    if where == "local":
        yield Workers(lambda: (local or processes)(jobs), jobs)
        return
    scheme, _, address = where.partition("://")
    if scheme != "dask" or ":" not in address:
        raise InputError(f"--executor {where}: there are local and dask://HOST:PORT.")
    try:
        distributed: Any = import_module("distributed")
        broken: Any = import_module("distributed.client").FutureCancelledError
    except ImportError:
        raise InputError(
            "--executor dask:// needs Dask, which is not installed: in a checkout, pip install "
            "'.[dask]'."
        ) from None
    try:
        client = distributed.Client(f"tcp://{address}", timeout=10)
    except OSError as problem:
        said = f": {problem}" if str(problem) else ""
        raise InputError(f"no Dask scheduler at {address}{said}.") from None
    with client:
        _check_versions(client)
        threads = max(1, sum(client.nthreads().values()))
        died = (distributed.KilledWorker, broken)
        page = str(getattr(client, "dashboard_link", "") or "")
        yield Workers(
            client.get_executor, threads, died, lambda: client.status == "running", page, TOGETHER
        )


def _check_versions(client: Any) -> None:
    """Errors: InputError where a worker would compute with another handcal, or with none."""
    own = version("handcal")
    try:
        found = client.run(version, "handcal")
    except PackageNotFoundError:
        raise InputError(
            "A worker of this Dask cluster has no handcal: install the same on all machines."
        ) from None
    other = sorted({f"{v} ({where})" for where, v in found.items() if v != own})
    if other:
        raise InputError(
            f"This is handcal {own}, and of the Dask cluster's workers {len(other)} run another: "
            f"{', '.join(other[:3])}. Install the same on all machines."
        )


def done(
    workers: Workers, submit: Callable[[Executor, T], Future[R]], tasks: Iterable[T]
) -> Iterator[tuple[T, R]]:
    """Tasks with what comes of them, as they are done; those of a process that died are given out
    again. tasks are asked for only as they can be given out.

    Errors: WorkersDied where processes die again and again, or no worker is left; what a
    task itself raises.
    """
    source, again, running = iter(tasks), deque[T](), dict[Future[R], T]()
    first = next(source, None)
    if first is None:
        return
    again.append(first)
    executor, deaths = workers.start(), 0
    died: tuple[type[BaseException], ...] = (*workers.died, FutureCancelled)
    try:
        while _filled(running, again, source, executor, submit, AHEAD * workers.count):
            finished, _ = wait(running, timeout=LOOK_S, return_when=FIRST_COMPLETED)
            if not (finished or workers.there()):
                running.clear()  # (no scheduler is left to tell)
                raise WorkersDied("The scheduler is gone; with --out the same command goes on.")
            broken = False
            # (in the order in which they were given out)
            for future in [future for future in running if future in finished]:
                task = running.pop(future)
                try:
                    result = future.result()
                except died as death:
                    broken = True
                    again.appendleft(task)
                    if deaths >= PATIENCE:
                        raise WorkersDied(
                            f"Processes died {deaths + 1} times in a row: {death}."
                        ) from None
                else:
                    deaths = 0
                    yield task, result
            if broken:
                deaths += 1
                again.extendleft(running.values())
                closed(executor, running)
                executor = workers.start()
    finally:
        closed(executor, running)


def _filled(
    running: dict[Future[R], T], again: deque[T], source: Iterator[T], executor: Executor,
    submit: Callable[[Executor, T], Future[R]], most: int,
) -> bool:  # fmt: skip
    """Give out tasks until so many run; whether any does."""
    while len(running) < most:
        again.extend(islice(source, 0 if again else 1))
        if not again:
            break
        task = again.popleft()
        running[_submitted(executor, submit, task)] = task
    return bool(running)


def closed(executor: Executor, running: dict[Future[R], T]) -> None:
    """Wait for nothing any more."""
    for future in running:
        future.cancel()
    running.clear()
    executor.shutdown(wait=False)


def _submitted(
    executor: Executor, submit: Callable[[Executor, T], Future[R]], task: T
) -> Future[R]:
    """The future of a task; one that failed if the executor has broken in the meantime."""
    try:
        return submit(executor, task)
    except BrokenExecutor as death:
        future: Future[R] = Future()
        future.set_exception(death)
        return future


def processes(jobs: int) -> Executor:
    """So many processes of this machine, each of one thread."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    # More threads would only be in each other's way.
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    return ProcessPoolExecutor(jobs, get_context("spawn"), _alone)


def _alone() -> None:
    """In a new process: an interrupt is for the parent to deal with, with whom it ends (a parent
    that was killed cannot tell its processes: they would wait for work for ever)."""
    from multiprocessing import parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_ends_with, args=(parent.sentinel,), daemon=True).start()


def _ends_with(parent: int) -> None:
    from multiprocessing.connection import wait as wait_for

    wait_for([parent])
    os._exit(1)
