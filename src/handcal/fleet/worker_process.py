"""A process that has imported what is needed and begins one process for each recording:
``python -m handcal.fleet.worker_process``.

A request is a line of JSON on standard input, an answer a line on standard output. The recording's
process is a copy of this one (fork), so it begins at once; it has a deadline and a limit of memory,
and whatever becomes of it, this process sees it from outside and says it. At the end of
standard input both end.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import select
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from typing import IO, Any, NoReturn

from handcal.fleet.record import CRASHED, DONE, FAILED, KILLED, OUT_OF_MEMORY, TIMED_OUT, Document

# Between looks at how much memory a process has: a page is touched in 0.1 us, so 0.05 s are at the
# most some hundred megabytes more than the limit.
LOOK_S = 0.05
READ = 1 << 16
# Of what a crashed process said last.
TAIL = 2000
CRASH_STATUS = 70  # EX_SOFTWARE of sysexits.h: an error of the program's own
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def main() -> None:
    """Answer until standard input ends."""
    asked, told = os.dup(0), os.dup(1)
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 0)
    os.dup2(null, 1)
    waiting = b""
    while True:
        while b"\n" not in waiting:
            some = os.read(asked, READ)
            if not some:
                return
            waiting += some
        line, _, waiting = waiting.partition(b"\n")
        request = json.loads(line)
        # (once, and not anew in each process; what cannot be imported, that process says)
        with suppress(ImportError):
            importlib.import_module(str(request["work"]).partition(":")[0])
        answer = _watched(request, asked)
        _write_all(told, json.dumps(answer).encode() + b"\n")


def _write_all(to: int, data: bytes) -> None:
    while data:
        data = data[os.write(to, data) :]


def _watched(request: Mapping[str, Any], asked: int) -> Document:
    """What became of one recording."""
    began = time.monotonic()
    result, send = os.pipe()
    with tempfile.TemporaryFile() as said:
        child = os.fork()
        if child == 0:
            os.close(result)
            _work(request, send, said)
        os.close(send)
        ended, data, peak = _waited(child, result, request, asked, began)
        os.close(result)
        _, status = os.waitpid(child, 0)
        said.seek(max(0, said.seek(0, os.SEEK_END) - TAIL))
        words = said.read().decode("utf-8", "replace")
    answer = ended or _told(status, data, words)
    return answer | {"seconds": time.monotonic() - began, "peak": peak}


def _waited(
    child: int, result: int, request: Mapping[str, Any], asked: int, began: float
) -> tuple[Document | None, bytes, int]:
    """Until the process closes its pipe: why it was ended from here (None: it was not), what it
    sent, and its largest memory in bytes."""
    deadline, memory = float(request["deadline"]), int(request["memory"])
    parts: list[bytes] = []
    peak = 0
    while True:
        ready, _, _ = select.select([result, asked], [], [], LOOK_S)
        peak = max(peak, resident(child))
        if asked in ready:  # (one request at a time: this is the end)
            os.kill(child, signal.SIGKILL)
            sys.exit(0)
        if result in ready:
            some = os.read(result, READ)
            if not some:
                return None, b"".join(parts), peak
            parts.append(some)
            continue
        if peak > memory:
            os.kill(child, signal.SIGKILL)
            reason = f"It needed more than {memory / 1e6:.0f} MB of memory."
            return {"status": OUT_OF_MEMORY, "reason": reason}, b"", peak
        if time.monotonic() - began > deadline:
            os.kill(child, signal.SIGKILL)
            reason = f"It was not finished after {deadline:g} s."
            return {"status": TIMED_OUT, "reason": reason}, b"", peak


def resident(process: int) -> int:
    """Memory of a process, bytes; 0 where the system does not say it (without /proc)."""
    try:
        with open(f"/proc/{process}/statm", "rb") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0


def _told(status: int, data: bytes, words: str) -> Document:
    """Of a process that ended by itself, or by somebody else."""
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        name = signal.Signals(number).name
        if number in (signal.SIGKILL, signal.SIGTERM):
            return {"status": KILLED, "reason": f"Its process was killed ({name})."}
        return {"status": CRASHED, "reason": f"Its process crashed ({name}).", "said": words}
    code = os.WEXITSTATUS(status)
    if code == 0 and data:
        answer: Document = json.loads(data)
        return answer
    last = next((line for line in reversed(words.splitlines()) if line.strip()), "")
    reason = f"Its process ended with status {code}" + (f": {last.strip()[:200]}" if last else "")
    return {"status": CRASHED, "reason": f"{reason}.", "said": words}


def _work(request: Mapping[str, Any], send: int, said: IO[bytes]) -> NoReturn:
    """In the new process: the work, and what came of it into the pipe."""
    os.dup2(said.fileno(), 2)
    if sys.platform == "linux":  # (the parent may be killed)
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    status = 0
    try:
        _write_all(send, json.dumps(_answer(request), allow_nan=False).encode())
    except BaseException:  # (not hidden: it is what the one who watches finds and tells)
        traceback.print_exc()
        sys.stderr.flush()
        status = CRASH_STATUS
    os._exit(status)


def _answer(request: Mapping[str, Any]) -> Document:
    from handcal.types import HandcalError

    module, _, name = str(request["work"]).partition(":")
    work = getattr(importlib.import_module(module), name)
    try:
        return {"status": DONE, "reason": "", "result": _as_texts(work(request))}
    except HandcalError as error:
        return {"status": getattr(error, "status", FAILED), "reason": str(error)}
    except MemoryError:
        return {"status": OUT_OF_MEMORY, "reason": "There was not enough memory."}


def _as_texts(result: Document) -> Document:
    """What travels: JSON that the asking process writes as it is, and what it must know of it."""
    explanation, fetched = result.pop("explanation"), result.pop("fetched")
    kept, explained = (json.dumps(d, allow_nan=False, ensure_ascii=False)
                       for d in (result, explanation))  # fmt: skip
    return {"kept": kept, "explanation": explained, "fetched": fetched}


if __name__ == "__main__":
    main()
