"""Compile what `handcal calibrate` and `explain` run, so that the first recording need not wait.

Compiled functions are kept beside the sources; this takes about half a minute on two cores.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

HANDCAL = (sys.executable, "-m", "handcal")
# Bytecode of what is imported is kept as well, whatever is said elsewhere: pip is told to make none
# (of all that is never used), and without it each start takes a second and a half more.
KEPT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def main() -> int:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = folder / "turns.mcap"
        made = subprocess.run(
            [*HANDCAL, "simulate", "three-turns", "--seed", "0", "-o", recording],
            stdout=subprocess.DEVNULL,
            env=KEPT,
            check=False,
        )
        if made.returncode:
            return made.returncode
        running = [
            subprocess.Popen(
                [*HANDCAL, command, recording, "--json", folder / f"{command}.json"],
                stdout=subprocess.DEVNULL,
                env=KEPT,
            )
            for command in ("calibrate", "explain")
        ]
        return max(child.wait() for child in running)


if __name__ == "__main__":
    sys.exit(main())
