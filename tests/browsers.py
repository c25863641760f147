"""A real browser for the tests of pages; where there is none they are skipped with the reason."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@contextmanager
def chromium(*more: str) -> Iterator[Browser]:
    """Chromium without a window; more: arguments."""
    path = shutil.which("chromium") or shutil.which("google-chrome")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if path is None:
        pytest.skip("no chromium on this machine")
    with api.sync_playwright() as p:
        started = p.chromium.launch(executable_path=path, args=["--no-sandbox", *more])
        yield started
        started.close()
