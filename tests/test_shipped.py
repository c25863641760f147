"""Machine code that comes with the package: used where it fits, and nowhere else."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numba
import pytest

from handcal.compiled import shipped
from handcal.compiled.jit import njit

SOURCE = "def twice(x):\n    return x + x\n"
COMPILE = (
    "import sys; sys.path.insert(0, sys.argv[1]); import one; from handcal.compiled.jit import "
    "njit; print(njit(one.twice)(2.5))"
)
pytestmark = pytest.mark.skipif(shipped.target() is None, reason="nothing is shipped for this")


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    """Machine code of the source, made as for another machine."""
    source = tmp_path_factory.mktemp("elsewhere") / "one.py"
    source.write_text(SOURCE)
    kept = source.parent / "kept"
    machine = {"NUMBA_CPU_NAME": shipped.target().name, "NUMBA_CPU_FEATURES": "",
               "NUMBA_CACHE_DIR": str(kept)}  # fmt: skip
    subprocess.run(
        [sys.executable, "-P", "-c", COMPILE, str(source.parent)], env=os.environ | machine,
        check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    return [p for p in kept.rglob("*.nb?") if p.name.startswith("one.twice")]


@pytest.fixture
def package(tmp_path, monkeypatch, elsewhere):
    """The source file of a package that it was shipped with."""
    source = tmp_path / "package" / "one.py"
    folder = source.parent / "shipped"
    folder.mkdir(parents=True)
    source.write_text(SOURCE)
    for path in elsewhere:
        shutil.copy(path, folder)
    monkeypatch.setattr(shipped, "PACKAGE", source.parent)
    monkeypatch.setattr(shipped, "FOLDER", folder)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "own"))
    shipped.runs_here.cache_clear()
    yield source
    shipped.runs_here.cache_clear()


def called(source, monkeypatch):
    """A function as a new process finds it, called: whether it was on disk."""
    spec = importlib.util.spec_from_file_location("one", source)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "one", module)
    spec.loader.exec_module(module)
    function = njit(module.twice)
    assert function(2.5) == 5.0
    return bool(function.stats.cache_hits)


def test_what_is_shipped_is_not_compiled_nor_kept_again(package, monkeypatch):
    assert called(package, monkeypatch)
    assert not list(Path(numba.config.CACHE_DIR).rglob("*.nbc"))


def test_another_source_is_compiled(package, monkeypatch):
    package.write_text(SOURCE + "\n")
    assert not called(package, monkeypatch)
    assert called(package, monkeypatch)


def test_a_processor_that_cannot_run_it_compiles_its_own(package, monkeypatch):
    lacking = replace(shipped.target(), needs=frozenset({"what no processor can"}))
    monkeypatch.setattr(shipped, "target", lambda: lacking)
    assert not called(package, monkeypatch)
    assert called(package, monkeypatch)


def test_a_damaged_one_is_compiled(package, monkeypatch):
    for path in shipped.FOLDER.glob("*.nbc"):
        path.write_bytes(path.read_bytes()[:50])
    assert not called(package, monkeypatch)
    assert called(package, monkeypatch)


def test_a_file_of_somebody_else_has_none():
    assert shipped.folder_of(__file__) is None
    own = shipped.folder_of(str(Path(shipped.__file__)))
    assert own == shipped.FOLDER / "compiled"
