"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def real_recordings() -> Path:
    """The folder of real recordings, which are not part of the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    folder = Path(os.environ.get("HANDCAL_RECORDINGS", beside))
    if not (folder / "xio_fusion.csv").is_file():
        pytest.skip(f"no real recordings in {folder} (set HANDCAL_RECORDINGS)")
    return folder
