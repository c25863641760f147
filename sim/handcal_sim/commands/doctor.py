"""The command `doctor`: is this installation complete, and does it compute what it should?"""

from __future__ import annotations

import platform
import re
from importlib.metadata import PackageNotFoundError, distribution, version

import typer

SHOWN = ("numpy", "scipy", "numba", "mcap", "rerun-sdk", "typer")
# What users install; the other extras are for development.
EXTRAS = {
    "live": "`handcal live`",
    "cloud": "recordings at an address",
    "dask": "sweeps and fleets on several machines",
    "notebook": "the notebooks",
}
WITHIN = 4.0  # sigma: wider than the worst of forty estimates by chance
SEED = 1


def doctor() -> None:
    """Show versions and extras, and test the installation: simulate, calibrate, compare.

    The test takes about ten seconds, the first time up to a minute longer: the filter is compiled.
    Exit status 1 if the test fails.
    """
    from rich.console import Console

    import handcal

    console = Console(highlight=False, soft_wrap=True)
    system = f"{platform.system()} {platform.machine()}"
    console.print(f"handcal {handcal.__version__}, Python {platform.python_version()}, {system}")
    console.print(", ".join(f"{name} {_version(name)}" for name in SHOWN))
    for extra, use in EXTRAS.items():
        missing = lacking(extra)
        state = f"not installed ({', '.join(missing)})" if missing else "installed"
        console.print(f"  {extra:<10}{state}: {use}")
    count, worst, seconds = self_test()
    told = f"{count} estimates, worst {worst:.1f} sigma from the truth, {seconds:.0f} s"
    # (a sum that is no number is no pass)
    if not worst < WITHIN:
        console.print(f"handcal does NOT work as it should: {told}; at most {WITHIN:.0f} asked.")
        console.print("Report it as a bug, with these lines.")
        raise typer.Exit(1)
    console.print(f"handcal works: {told}.")


def lacking(extra: str) -> list[str]:
    """Packages of an extra that are not installed, by name."""
    marked = re.compile(rf"""extra\s*==\s*["']{extra}["']""")
    required = [r for r in distribution("handcal").requires or [] if marked.search(r)]
    names = [re.split(r"[^\w.-]", r, maxsplit=1)[0] for r in required]
    return [name for name in names if _version(name) == "missing"]


def self_test() -> tuple[int, float, float]:
    """Calibrate a simulated phone: number of estimates, the largest distance from the truth in
    sigma, seconds."""
    import tempfile
    import time
    from pathlib import Path

    import numpy as np

    import handcal
    from handcal_sim.commands.demo import CONCEALED, concealing, off_by, truth_of
    from handcal_sim.mcap_writer import write

    begun = time.monotonic()
    world = concealing(SEED)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "self-test.mcap"
        write(world, file)
        result = handcal.calibrate(handcal.load(file), [CONCEALED], assume="fixed-point")
    truth = truth_of(world)
    off = [abs(off_by(p, truth)) for p in result.parameters]
    # (np.max hands on what is no number, max need not)
    return len(off), float(np.max(off)), time.monotonic() - begun


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"
