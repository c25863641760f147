"""Rules that hold for the whole project and are cheap to check."""

import ast
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = [p for folder in ("src", "sim") for p in sorted((ROOT / folder).rglob("*.py"))]
HEAVY = ("numpy", "scipy", "numba", "filterpy", "rerun", "matplotlib")


def test_every_public_function_has_a_docstring():
    """Classes too; what a module with a leading underscore holds is not public."""
    missing = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
        for path in SOURCES
        if path.name == "__init__.py" or not path.name.startswith("_")
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        and not node.name.startswith("_")
        and ast.get_docstring(node) is None
        and not any(ast.unparse(d) == "overload" for d in node.decorator_list)
    ]
    assert len(SOURCES) > 0
    assert missing == []


def test_no_function_is_longer_than_forty_lines():
    """Signature and docstring aside: those are what makes an option or an array understood."""
    long = []
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                first = node.body[1 if ast.get_docstring(node) and len(node.body) > 1 else 0]
                lines = node.end_lineno - first.lineno + 1
                if lines > 40:
                    long.append(f"{path.relative_to(ROOT)}:{node.lineno} {node.name}: {lines}")
    assert long == []


def test_no_committed_file_names_a_folder_of_this_machine():
    """A path that holds on one machine only is of no use in a repository."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout: there is no list of committed files")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    files = [ROOT / name for name in listed.stdout.decode().split("\0") if name]
    # Folders that other machines have too (/tmp, /usr/src) may be named.
    shared = {Path("/"), Path("/usr"), Path("/usr/src"), Path("/opt"), Path(tempfile.gettempdir())}
    folders = {ROOT, ROOT.parent, Path.home()} - shared
    pattern = re.compile(
        rb"(?<![\w.~/-])(" + b"|".join(re.escape(str(f).encode()) for f in folders) + rb")(?![\w-])"
    )
    found = [
        f"{path.relative_to(ROOT)}: {match.group().decode()}"
        for path in files
        if path.is_file() and (match := pattern.search(path.read_bytes()))
    ]
    assert found == []


def test_help_imports_nothing_heavy():
    """`handcal --help` must answer at once, so the numeric packages are imported where used."""
    code = f"""
import sys
sys.argv = ["handcal", "--help"]
from handcal.commands._app import main
try:
    status = main()
except SystemExit as stop:
    status = stop.code
loaded = [name for name in {HEAVY!r} if name in sys.modules]
sys.exit(f"status {{status}}, loaded {{loaded}}" if status or loaded else 0)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "simulate" in run.stdout
