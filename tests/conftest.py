"""Fixtures for all tests."""

from __future__ import annotations

import os
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

# Before numpy is imported: threads on matrices of twenty rows cost more than they bring.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# Bytecode is kept, whatever is said elsewhere: without it each worker compiles all tests anew, and
# each command that a test starts all of handcal.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

import pytest  # noqa: E402

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="session")
def real_recordings() -> Path:
    """The folder of real recordings, which are not part of the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    folder = Path(os.environ.get("HANDCAL_RECORDINGS", beside))
    if not (folder / "xio_fusion.csv").is_file():
        pytest.skip(f"no real recordings in {folder} (set HANDCAL_RECORDINGS)")
    return folder


@pytest.fixture(scope="session")
def cases() -> Path:
    """The folder of files as people have them, which are not part of the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "cases"
    folder = Path(os.environ.get("HANDCAL_CASES", beside))
    if not folder.is_dir():
        pytest.skip(f"no cases in {folder} (set HANDCAL_CASES)")
    return folder


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """For what a page says besides: drawing takes most of its time."""
    from handcal.show.calibration import plots as of_calibration
    from handcal.show.explanation import plots as of_explanation

    for module in (of_calibration, of_explanation):
        monkeypatch.setattr(module, "draw", lambda _: defaultdict(list))


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    from browsers import chromium

    with chromium() as started:
        yield started


@pytest.fixture(scope="session", autouse=True)
def _results_follow_their_schemas() -> Iterator[None]:
    """Every result that any test of this process writes is held against its schema."""
    import schemas

    from handcal.show.calibration import summary

    stamped = summary.stamped

    def checked(document: Mapping[str, Any]) -> dict[str, Any]:
        whole = stamped(document)
        if str(whole["schema"]).startswith("handcal"):
            schemas.check(whole)
        return whole

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(summary, "stamped", checked)
        yield
