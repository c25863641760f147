"""Run a handcal command and look every few milliseconds at what its first thread is doing.

A script of its own, which imports nothing large (what it imports, the command finds there). Where
the command ends well it writes one line on stderr: ``SAMPLED`` and, as JSON, seconds by the module
that was at work and by the step that had asked for it. Copies of the process, which do what can be
done beside it, are not looked at; while it waits for one, that is ``estimate.forked``.
"""

import json
import runpy
import sys
import threading
import time
from collections import defaultdict
from types import FrameType

# Looks take 0.03 ms each: half a percent.
EVERY_S = 0.005
SAMPLED = "sampled "
IMPORTING, MACHINE_CODE, OTHER = "importing", "loading or making machine code", "other"
OWN, MACHINE = ("handcal", "handcal_sim"), ("numba", "llvmlite")
# What only does as it is told; who told it is found further out.
TOLD = ("estimate", "effects", "compiled", "observations", "signals", "types", "units", "output")
Seconds = defaultdict[str, float]


def main(arguments: list[str]) -> None:
    """The command, looked at. Leaves as the command does."""
    doing: Seconds = defaultdict(float)
    asked_by: Seconds = defaultdict(float)
    over, first = threading.Event(), threading.get_ident()
    sampler = threading.Thread(target=look, args=(first, over, doing, asked_by), daemon=True)
    sampler.start()
    sys.argv = ["handcal", *arguments]
    status: str | int | None = None
    try:
        runpy.run_module("handcal", run_name="__main__", alter_sys=True)
    except SystemExit as ended:
        status = ended.code
    finally:
        over.set()
        sampler.join()
    if not status:  # (else the last line says what failed)
        found = {"doing": doing, "asked_by": asked_by}
        print(SAMPLED + json.dumps(found), file=sys.stderr, flush=True)
    sys.exit(status)


def look(thread: int, over: threading.Event, doing: Seconds, asked_by: Seconds) -> None:
    """Add up where that thread is, until it is over; each look counts for the time since the one
    before (compiled code that lets no other thread run is so counted in full)."""
    last = time.perf_counter()
    while not over.wait(EVERY_S):
        frame = sys._current_frames().get(thread)
        now = time.perf_counter()
        at, step = where(frame)
        doing[at] += now - last
        asked_by[step] += now - last
        last = now


def where(frame: FrameType | None) -> tuple[str, str]:
    """The module that is at work, as seen from ``handcal``, and that of the step that asked."""
    doing, library, importing, machine = "", "", False, False
    while frame is not None:
        code, module = frame.f_code, str(frame.f_globals.get("__name__", ""))
        package, _, name = module.partition(".")
        if package not in OWN:
            importing = importing or code.co_filename.startswith("<frozen importlib")
            machine = machine or package in MACHINE
            library = package if code.co_name == "<module>" else library
        elif not doing and (importing or code.co_name == "<module>"):
            return f"importing {library or package}", IMPORTING
        else:
            doing = doing or (MACHINE_CODE if machine else name or package)
            if name.partition(".")[0] not in (*TOLD, ""):
                return doing, name
        frame = frame.f_back
    return doing or OTHER, OTHER


if __name__ == "__main__":
    main(sys.argv[1:])
