"""Writes the map of the code into README.md: the layers that the import linter checks, and what the
packages say of themselves; `make docs` runs it."""

from __future__ import annotations

import ast
from configparser import ConfigParser
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
README, SOURCE = ROOT / "README.md", ROOT / "src" / "handcal"
BEGIN, END = "<!-- layers: written by make docs -->\n", "<!-- end of layers -->\n"


def layers() -> list[list[str]]:
    """Packages and modules of handcal, each layer importing only from those below it."""
    contracts = ConfigParser()
    contracts.read(ROOT / ".importlinter")
    lines = contracts["importlinter:contract:layers"]["layers"].split("\n")
    return [[n.strip() for n in line.split(":")] for line in lines if line.strip()]


def said(name: str) -> str:
    """The first sentence of what a package or module says of itself."""
    folder = SOURCE / name
    file = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def table() -> str:
    """The map: one line a package, layers apart."""
    parts = []
    for layer in layers():
        shown = [n + "/" if (SOURCE / n).is_dir() else n + ".py" for n in layer]
        parts.append("\n".join(f"{s:<16}{said(n)}" for s, n in zip(shown, layer, strict=True)))
    return "```\n" + "\n\n".join(parts[1:]) + "\n```\n"


def written(text: str) -> str:
    """The page with the map in its place."""
    before, rest = text.split(BEGIN)
    return before + BEGIN + table() + END + rest.split(END)[1]


if __name__ == "__main__":
    README.write_text(written(README.read_text(encoding="utf-8")), encoding="utf-8")
