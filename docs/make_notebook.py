"""Runs docs/python.ipynb and keeps what it shows; `make docs` runs it."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

PAGE = Path(__file__).with_name("python.ipynb")


def executed() -> nbformat.NotebookNode:
    """The notebook as it comes out in an empty folder. Errors: nbclient's, where a cell fails."""
    page = nbformat.read(PAGE, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(page, timeout=300, resources={"metadata": {"path": folder}})
        client.execute()
    for cell in page.cells:
        cell.metadata.clear()
    page.metadata = {"language_info": {"name": "python"}, "kernelspec": page.metadata.kernelspec}
    return page


if __name__ == "__main__":
    os.environ.setdefault("JUPYTER_PLATFORM_DIRS", "1")
    nbformat.write(executed(), PAGE)
