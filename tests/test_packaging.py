"""What is handed out is whole: the wheel works alone, bill of materials and licences name all."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import pytest
from test_docs import made

import handcal.results
import handcal_sim.results
from handcal.types import CALIBRATION_SCHEMA

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "scripts"))
import audit  # noqa: E402
import dependencies  # noqa: E402
import sbom  # noqa: E402

MOST_MB = 550
PLAIN = ("OMP_NUM_THREADS", "PATH", "HOME", "TMPDIR")


def named():
    """Plain names of all that pyproject.toml asks for, and of extras, from the file itself."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extra = [d for several in project["optional-dependencies"].values() for d in several]
    names = [d.split("[")[0].split(">")[0].split("=")[0] for d in project["dependencies"] + extra]
    return {dependencies.plain(n) for n in names}


def test_the_licence_of_every_dependency_is_on_the_page():
    """If not: `make docs`, or docs/make_licences.py alone."""
    shown = made("make_licences").stated()
    brought = dependencies.closure(dependencies.direct(distribution("handcal")))
    assert named() | set(brought) <= set(shown)
    pinned = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    for name in set(shown) - {"package"}:
        one = dependencies.package(name)
        if one and f"{one.name}=={one.version}" in pinned:
            assert shown[name] == one.licence
        assert shown[name] not in ("", "not stated")


def test_the_bill_of_materials_names_what_is_installed_and_what_needs_what():
    bill = sbom.document()
    refs = {c["bom-ref"] for c in bill["components"]}
    for name in ("numpy", "rerun-sdk", "pyarrow", "llvmlite"):
        assert f"pkg:pypi/{name}@{distribution(name).version}" in refs
    own = bill["metadata"]["component"]["bom-ref"]
    ways = {d["ref"]: set(d["dependsOn"]) for d in bill["dependencies"]}
    assert set(ways) == refs | {own}
    reached, todo = set(), [own]
    while todo:
        todo += ways[here := todo.pop()] - reached
        reached.add(here)
    assert reached == refs | {own}
    assert not any("pytest" in ref or "sphinx" in ref.lower() for ref in refs)
    assert bill["serialNumber"] == sbom.document()["serialNumber"]


def test_an_audit_that_asked_nobody_is_no_success(capsys, monkeypatch):
    mirror = [{"name": "a", "skip_reason": "not found"}]
    assert audit.said(mirror) == (
        "Nothing was audited: what answers here knows none of the packages.", 1)  # fmt: skip
    hole = {"name": "b", "version": "1", "vulns": [{"id": "X-1", "fix_versions": ["1.1"]}]}
    text, status = audit.said([*mirror, hole])
    assert status == 1
    assert "b 1: X-1, cured in 1.1" in text
    assert "Not in the database: a." in text
    assert audit.said([hole | {"vulns": []}])[1] == 0

    def cut_off(*_a, **_k):
        return subprocess.CompletedProcess([], 1, "", "Traceback\nConnectionError: refused")

    monkeypatch.setattr(subprocess, "run", cut_off)
    assert audit.main() == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith("Nothing was audited: no database could be reached (Conn")


def build(folder):
    """Source archive and wheel of this checkout."""
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-d", str(folder)], cwd=ROOT,
                   check=True, capture_output=True)  # fmt: skip
    return next(folder.glob("*.tar.gz")), next(folder.glob("*.whl"))


def test_wheel_and_source_archive_hold_every_file_of_the_program(tmp_path):
    source, wheel = build(tmp_path)
    with zipfile.ZipFile(wheel) as z:
        held = {n for n in z.namelist() if ".dist-info/" not in n}
        written = {Path(n).stem: json.loads(z.read(n)) for n in held if "/schemas/" in n}
    files = {p.relative_to(top).as_posix()
             for top in (ROOT / "src", ROOT / "sim")
             for p in top.rglob("*")
             if p.is_file() and "__pycache__" not in p.parts}  # fmt: skip
    assert {n for n in held if "/schemas/" not in n} == files
    assert written == handcal.results.schemas() | handcal_sim.results.schemas()
    assert {"handcal/schemas/calibrate.json", "handcal_sim/schemas/sweep.json"} <= held
    with tarfile.open(source) as t:
        names = {n.partition("/")[2] for n in t.getnames()}
    assert {"pyproject.toml", "constraints.txt", "Makefile", "tests/test_packaging.py"} <= names
    assert {f"src/{n}" for n in files if n.startswith("handcal/")} <= names


@pytest.mark.prove
def test_the_wheel_works_in_an_environment_of_its_own(tmp_path):
    """Only what `pip install` brings, in the versions of constraints.txt. Needs a package index."""
    _, wheel = build(tmp_path)
    plain = {k: v for k, v in os.environ.items() if k in PLAIN or k.startswith("PIP_")}
    python = tmp_path / "own/bin/python"

    def run(*command):
        return subprocess.run(list(map(str, command)), cwd=tmp_path, env=plain, check=True,
                              capture_output=True, text=True).stdout  # fmt: skip

    run(sys.executable, "-m", "venv", tmp_path / "own")
    run(python, "-m", "pip", "install", "-q", "--no-compile", "-c", ROOT / "constraints.txt", wheel)
    run(python, ROOT / "scripts/size.py", "--most", 510)
    handcal = tmp_path / "own/bin/handcal"
    version = wheel.name.split("-")[1]
    assert run(handcal, "--version") == f"handcal {version}\n"
    run(handcal, "simulate", "three-turns", "--seed", "0", "-o", "a.mcap")
    run(handcal, "calibrate", "a.mcap", "--json", "a.json", "--report", "a.html")
    said = json.loads((tmp_path / "a.json").read_text("utf-8"))
    assert (said["schema"], said["version"]) == (CALIBRATION_SCHEMA, version)
    # with the bytecode of what these commands use, and the compiled kernels
    print(run(python, ROOT / "scripts/size.py", "--most", MOST_MB))
