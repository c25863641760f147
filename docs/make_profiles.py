"""Writes docs/profiles.md, where the time of each command goes, from what `handcal bench --json`
measured; `make bench` runs it with the file's name."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from handcal.bench.timing import shares

FILE = Path(__file__).resolve().parent / "profiles.md"
INTRODUCTION = """# Where the time of each command goes

*Reference.* `make bench` writes this page. It samples the first thread of each running command every 5 ms (groups {groups} of `handcal bench`). *At work* is the module of handcal that the processor is in, compiled functions and numpy within it included; *for* is the step that asked. `estimate.forked` is waiting for the copy of the process that does other work meanwhile ([the second core](dev/performance.md#what-made-it-faster)). Parts below {least} % are left out. What the next factor of two would take stands in [How fast](dev/performance.md).

handcal {handcal}, numba {numba}, numpy {numpy}, Python {python}, {cores} cores.
"""  # noqa: E501
# Percent of a command from which on a part is told.
LEAST = 3.0


def parts(seconds: dict[str, float]) -> str:
    """The parts of a whole, the largest first."""
    told = (f"{name} {share:.0f} %" for name, share in shares(seconds) if share >= LEAST)
    return "<br>".join(told)


def page(document: dict[str, Any]) -> str:
    """The page of a result of `handcal bench`."""
    profiles, machine = document["profiles"], document["machine"]
    groups = ", ".join(f"`{g}`" for g in dict.fromkeys(p["group"] for p in profiles))
    head = INTRODUCTION.format(
        groups=groups, least=f"{LEAST:g}", python=machine["python"], cores=machine["cores"],
        **machine["versions"],
    )  # fmt: skip
    lines = [head, "| | s | at work | for |", "|---|---|---|---|"]
    lines += [
        f"| {p['title']} | {sum(p['doing'].values()):.3g} | {parts(p['doing'])} "
        f"| {parts(p['asked_by'])} |"
        for p in profiles
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python docs/make_profiles.py FILE (of handcal bench --json)")
    measured = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    FILE.write_text(page(measured), encoding="utf-8")
