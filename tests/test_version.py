"""The version is git's last tag, whatever the checkout; it costs the start-up nothing."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import handcal

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def copy(tmp_path, monkeypatch):
    """pyproject.toml alone, in a folder without git; nobody's settings of git count there."""
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path)
    who = {"NAME": "nobody", "EMAIL": "nobody@example.org"}
    for key, value in who.items():
        monkeypatch.setenv(f"GIT_AUTHOR_{key}", value)
        monkeypatch.setenv(f"GIT_COMMITTER_{key}", value)
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", os.devnull)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    return tmp_path


def git(folder, *arguments):
    subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True)


def built(folder):
    """The version that a build in this folder would have."""
    run = [sys.executable, "-m", "hatchling", "version"]
    done = subprocess.run(run, cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
def test_tags_make_the_version_and_without_them_there_is_one_all_the_same(copy):
    assert built(copy) == "0.1.0.dev0"
    git(copy, "init", "-q")
    git(copy, "add", ".")
    git(copy, "commit", "-qm", "first")
    assert built(copy).startswith("0.1.0.dev1+g")
    git(copy, "tag", "-a", "v0.7.0", "-m", "x")
    assert built(copy) == "0.7.0"
    git(copy, "commit", "-q", "--allow-empty", "-m", "second")
    assert built(copy).startswith("0.7.1.dev1+g")


def test_the_version_is_that_of_the_installation_or_unknown(monkeypatch):
    assert handcal.__version__ == importlib.metadata.version("handcal")
    assert "__version__" in dir(handcal)

    def nowhere(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", nowhere)
    assert handcal.__version__ == handcal.UNKNOWN


def test_nobody_looks_the_version_up_before_it_is_used():
    code = "import sys, handcal; print('importlib.metadata' in sys.modules)"
    run = [sys.executable, "-S", "-c", f"import sys; sys.path[:0] = {sys.path!r}; {code}"]
    assert subprocess.run(run, check=True, capture_output=True, text=True).stdout == "False\n"
