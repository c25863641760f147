"""Processes that explain recordings, of which they are told the path and nothing else.

A process takes one path a line and answers with one line of JSON. It is started anew
when it dies: that recording counts as failed, the others go on.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

Document = Mapping[str, Any]
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Stopped(Exception):
    """The processes were ended on purpose."""


class Workers:
    """So many processes of one command; calling this waits for a free one. Thread-safe."""

    def __init__(self, command: Sequence[str], count: int) -> None:
        self.command = list(command)
        self.environment = dict(os.environ)
        if count > 1:
            self.environment |= dict.fromkeys(_ONE_THREAD, "1")
        self.stopped = False
        self.running: set[subprocess.Popen[str]] = set()
        self.free: queue.SimpleQueue[subprocess.Popen[str] | None] = queue.SimpleQueue()
        for _ in range(count):
            self.free.put(None)  # started when first needed

    def __call__(self, path: Path) -> tuple[Document, float]:
        """The explanation of a recording, or {"error": ...}, and the seconds it took."""
        process = self.free.get()
        try:
            if self.stopped:
                raise Stopped
            process = process or self._start()
            reply = _ask(process, path)
            if reply is None:
                if self.stopped:
                    raise Stopped
                status = process.wait()
                self._end(process)
                process = None
                return {"error": f"the process ended with status {status}"}, 0.0
            return reply["document"], float(reply["seconds"])
        finally:
            self.free.put(process)

    def _start(self) -> subprocess.Popen[str]:
        # In a session of its own: an interrupt is for the parent to deal with.
        process = subprocess.Popen(
            self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True, env=self.environment, start_new_session=True,
        )  # fmt: skip
        self.running.add(process)
        return process

    def stop(self) -> None:
        """End them all."""
        self.stopped = True
        for process in list(self.running):
            # (with what it has started: the session is its own)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            self._end(process)

    def _end(self, process: subprocess.Popen[str]) -> None:
        self.running.discard(process)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


def _ask(process: subprocess.Popen[str], path: Path) -> dict[str, Any] | None:
    """What the process answers; None if it died."""
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.stdin.write(f"{path}\n")
        process.stdin.flush()
        line = process.stdout.readline()
    except (OSError, ValueError):  # ended, or closed by `stop` meanwhile
        return None
    reply: dict[str, Any] | None = json.loads(line) if line.endswith("\n") else None
    return reply


def serve(explain: Callable[[str], Document]) -> None:
    """The other side: answers on standard output, which nothing else may use."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    for line in sys.stdin:
        started = time.perf_counter()
        try:
            document = explain(line.rstrip("\n"))
        except Exception:
            document = {"error": traceback.format_exc()}
        reply = {"seconds": time.perf_counter() - started, "document": document}
        print(json.dumps(reply), file=answers, flush=True)
