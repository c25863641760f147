"""Run a command, end with its status, and print what it used: seconds by the clock, processor
seconds, the most memory (ru_maxrss); the last two are not known on every system.

A script of its own, which imports nothing large: a process counts as its own the memory that its
parent had when it was begun, which for one that measures is hundreds of megabytes.
"""

import math
import os
import signal
import subprocess
import sys
import time


def main(command: list[str]) -> int:
    """What the command ended with."""
    children: list[subprocess.Popen[bytes]] = []

    def end(*_: object) -> None:
        for one in children:
            one.terminate()
        if not children:
            sys.exit(1)

    # (who is told to end ends what is measured; of Ctrl-C both hear)
    signal.signal(signal.SIGTERM, end)
    begin, cpu, most = time.perf_counter(), math.nan, math.nan
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    children.append(child)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform != "win32":
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        cpu, most = used.ru_utime + used.ru_stime, float(used.ru_maxrss)
    child.wait()
    print(time.perf_counter() - begin, cpu, most)
    return child.returncode if child.returncode >= 0 else 128 - child.returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
