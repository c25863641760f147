"""Run the quick tests and list the hundred slowest with what each proves (`make slowest`).

A test that is run with several parameters is one row: its seconds, setup included, how many cases
it has, and the first line of its docstring, or its name in words.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]


def proves(module: str, name: str) -> str:
    """What a test of a module (tests.test_x) says it proves."""
    tree = ast.parse((ROOT / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8"))
    said = {n.name: ast.get_docstring(n) for n in tree.body if isinstance(n, ast.FunctionDef)}
    return (said.get(name) or name.removeprefix("test_").replace("_", " ")).splitlines()[0]


with tempfile.TemporaryDirectory() as folder:
    report = Path(folder) / "tests.xml"
    command = [sys.executable, "-m", "pytest", "-n", "auto", "--dist", "loadfile", "-m"]
    done = subprocess.run([*command, "not prove", f"--junitxml={report}"], cwd=ROOT, check=False)
    cases = list(ElementTree.parse(report).iter("testcase"))
seconds: dict[tuple[str, str], list[float]] = defaultdict(list)
for case in cases:
    seconds[case.get("classname", ""), case.get("name", "").partition("[")[0]].append(
        float(case.get("time", "0"))
    )
print(f"{len(cases)} cases, {sum(map(sum, seconds.values())):.0f} s in all.")
for (module, name), each in sorted(seconds.items(), key=lambda one: -sum(one[1]))[:100]:
    print(f"{sum(each):6.1f} s {len(each):4d} {module.rpartition('.')[2]}: {proves(module, name)}")
sys.exit(done.returncode)
