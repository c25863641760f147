"""Runs the notebooks of docs/ and keeps what they show; `make docs` runs it."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

PAGES = tuple(sorted(Path(__file__).parent.glob("*.ipynb")))


def executed(path: Path) -> nbformat.NotebookNode:
    """The notebook as it comes out in an empty folder. Errors: nbclient's, where a cell fails."""
    page = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(page, timeout=300, resources={"metadata": {"path": folder}})
        client.execute()
    for cell in page.cells:
        cell.metadata.clear()
    page.metadata = {"language_info": {"name": "python"}, "kernelspec": page.metadata.kernelspec}
    return page


if __name__ == "__main__":
    os.environ.setdefault("JUPYTER_PLATFORM_DIRS", "1")
    for name in sys.argv[1:] or [p.name for p in PAGES]:
        target = Path(__file__).with_name(name)
        nbformat.write(executed(target), target)
