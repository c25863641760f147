"""Ask a database of known vulnerabilities about the versions in constraints.txt; `make audit`.

Status: 0 none is known, 1 some are, or nothing could be asked, which a sentence says.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

PINNED = Path(__file__).resolve().parents[1] / "constraints.txt"


def said(packages: list[dict[str, object]]) -> tuple[str, int]:
    """What to print of pip-audit's answer, and the status."""
    asked = [p for p in packages if "skip_reason" not in p]
    if not asked:  # (a mirror without the database: pip-audit itself calls that a success)
        return "Nothing was audited: what answers here knows none of the packages.", 1
    lines = [
        f"{p['name']} {p['version']}: {v['id']}, cured in {', '.join(v['fix_versions']) or '?'}"
        for p in asked
        for v in p["vulns"]
    ]
    if left := [str(p["name"]) for p in packages if "skip_reason" in p]:
        lines.append(f"Not in the database: {', '.join(left)}.")
    found = sum(len(p["vulns"]) for p in asked)
    lines.append(f"{len(asked)} packages asked about, {found or 'no'} known vulnerabilities.")
    return "\n".join(lines), int(found > 0)


def main(pinned: Path = PINNED) -> int:
    """Print the answer. Returns the status."""
    command = [sys.executable, "-m", "pip_audit", "--no-deps", "--disable-pip", "-f", "json",
               "--progress-spinner", "off", "-r", str(pinned)]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    try:
        text, status = said(json.loads(done.stdout)["dependencies"])
    except json.JSONDecodeError:
        reason = (done.stderr.strip().splitlines() or ["no answer"])[-1][:200]
        text, status = f"Nothing was audited: no database could be reached ({reason}).", 1
    print(text, file=sys.stderr if status else sys.stdout)
    return status


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:2])))
