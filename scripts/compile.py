"""Compile what `handcal calibrate` and `explain` run, so that the first recording need not wait.

Compiled functions are kept beside the sources; this takes about half a minute on two cores. With
--ship it is done for what most machines can do, to be packed into a wheel.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HANDCAL = (sys.executable, "-m", "handcal")
# Bytecode of what is imported is kept as well, whatever is said elsewhere: pip is told to make none
# (of all that is never used), and without it each start takes a second and a half more.
KEPT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def compiled(own: dict[str, str]) -> int:
    """Run what is to be compiled; own: its environment. The worst status."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = folder / "turns.mcap"
        made = subprocess.run(
            [*HANDCAL, "simulate", "three-turns", "--seed", "0", "-o", recording],
            stdout=subprocess.DEVNULL,
            env=own,
            check=False,
        )
        if made.returncode:
            return made.returncode
        running = [
            subprocess.Popen(
                [*HANDCAL, command, recording, "--json", folder / f"{command}.json"],
                stdout=subprocess.DEVNULL,
                env=own,
            )
            for command in ("calibrate", "explain")
        ]
        return max(child.wait() for child in running)


def ship() -> int:
    """Compile everything for what most machines can do and put it beside the sources, from where
    `make dist` takes it. 1 where there is no such machine of this kind."""
    from numba.core.caching import UserProvidedCacheLocator

    from handcal.compiled.shipped import FOLDER, PACKAGE, target

    chosen = target()
    if chosen is None:
        return 1
    shutil.rmtree(FOLDER, ignore_errors=True)
    with tempfile.TemporaryDirectory() as kept:
        machine = {"NUMBA_CPU_NAME": chosen.name, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": kept}
        status = compiled(KEPT | machine)
        if status:
            return status
        for folder in {p.parent for p in PACKAGE.rglob("*.py")}:
            below = UserProvidedCacheLocator.get_suitable_cache_subpath(str(folder / "one.py"))
            # (parts are for compiling what calls them, which is done already)
            code = [p for ending in ("nbi", "nbc") for p in (Path(kept) / below).glob(f"*.{ending}")
                    if not p.name.startswith("part-")]  # fmt: skip
            to = FOLDER / folder.relative_to(PACKAGE)
            for path in code:
                to.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, to)
    return 0


def main() -> int:
    """Compile for this machine, or with --ship for others."""
    return ship() if sys.argv[1:] == ["--ship"] else compiled(KEPT)


if __name__ == "__main__":
    sys.exit(main())
