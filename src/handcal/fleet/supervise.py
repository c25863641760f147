"""The processes that watch over recordings (``worker_process``), one for each thread that works:
begun when first needed, ended with it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from typing import Any

from handcal.fleet.record import CRASHED, KILLED, Document
from handcal.workers import ONE_THREAD

# A recording whose process was killed from outside is begun again; with one worker of three killed
# each minute and 20 s a recording, three in a row hit one recording in a thousand by chance.
TRIES = 3


class Watcher:
    """The process, and one question at a time."""

    def __init__(self) -> None:
        # -P: not what happens to lie where the command is run. A session of its own: Ctrl-C is for
        # the one who asks, and the whole of it can be ended at once.
        command = [sys.executable, "-P", "-m", "handcal.fleet.worker_process"]
        one = dict.fromkeys(ONE_THREAD, "1")
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
            env=os.environ | one, bufsize=0,
        )  # fmt: skip

    def ask(self, request: Mapping[str, Any]) -> Document | None:
        """What became of a recording; None where the watcher itself is gone."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write(json.dumps(dict(request)).encode() + b"\n")
            line = _line(self.process.stdout)
        except OSError:
            return None
        if not line.endswith(b"\n"):
            return None
        answer: Document = json.loads(line)
        return answer

    def end(self) -> None:
        """End it, with whatever it has begun."""
        with suppress(OSError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


def _line(stream: Any) -> bytes:
    parts = []
    while True:
        some = stream.read(1 << 16)
        parts.append(some)
        if not some or some.endswith(b"\n"):
            return b"".join(parts)


class Watchers:
    """Those of this process, by thread."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.by_thread: dict[int, Watcher] = {}
        self.over = False

    def mine(self) -> Watcher:
        """That of this thread, begun if there is none."""
        me = threading.get_ident()
        with self.lock:
            if self.over:
                raise RuntimeError("the work is over")
            if me not in self.by_thread:
                self.by_thread[me] = Watcher()
            return self.by_thread[me]

    def lost(self) -> None:
        """That of this thread is gone."""
        with self.lock:
            gone = self.by_thread.pop(threading.get_ident(), None)
        if gone is not None:
            gone.end()

    def end(self) -> None:
        """End them all, for good."""
        with self.lock:
            self.over = True
            for watcher in self.by_thread.values():
                with suppress(OSError):
                    os.killpg(watcher.process.pid, signal.SIGKILL)

    def forget(self) -> None:
        """Close what is left of those that were ended, when no thread asks any more."""
        for watcher in self.by_thread.values():
            watcher.end()
        self.by_thread.clear()


@cache
def of_this_process() -> Watchers:
    """The watchers of a process that others give work to (a worker of Dask's)."""
    return Watchers()


def supervised_all(
    requests: Sequence[Mapping[str, Any]], watchers: Watchers | None = None
) -> list[Document]:
    """What became of recordings that travelled together, one after the other."""
    return [supervised(request, watchers) for request in requests]


def supervised(request: Mapping[str, Any], watchers: Watchers | None = None) -> Document:
    """What became of one recording, whatever it was: ``status``, ``reason``, ``result`` where there
    is one, ``seconds``, ``peak`` (bytes) and ``tries``."""
    own = of_this_process() if watchers is None else watchers
    answer: Document = {}
    for tries in range(1, TRIES + 1):
        told = own.mine().ask(request)
        if told is None:
            own.lost()
            told = {"status": KILLED, "reason": "The process that watched it was killed.",
                    "seconds": 0.0, "peak": 0}  # fmt: skip
        answer = told | {"tries": tries}
        if answer["status"] != KILLED:
            break
    if answer["status"] in (KILLED, CRASHED) and answer["tries"] > 1:
        answer["reason"] += f" So it went {answer['tries']} times."
    return answer


class Local(Executor):
    """Threads of this process, each of which watches a watcher of its own."""

    def __init__(self, jobs: int) -> None:
        self.watchers = Watchers()
        self.threads = ThreadPoolExecutor(jobs)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have ``fn`` done, which is told of this executor's watchers."""
        return self.threads.submit(fn, *args, watchers=self.watchers, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End at once what still runs (neither option is heard)."""
        del wait, cancel_futures
        self.watchers.end()
        self.threads.shutdown(wait=True, cancel_futures=True)
        self.watchers.forget()
