"""Draws docs/images/layers.svg, the packages in the layers that the import linter checks, with what
each says of itself; `make docs` runs it."""

from __future__ import annotations

import ast
import textwrap
from configparser import ConfigParser
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE, PICTURE = ROOT / "src" / "handcal", ROOT / "docs" / "images" / "layers.svg"
LINE, GAP, WIDE, NAME = 18, 10, 900, 150  # px
LETTERS = 105  # that fit beside a name


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
    return (
        " ".join(text.split("\n\n")[0].split()).replace("``", "").split(". ")[0].rstrip(".") + "."
    )


def picture() -> str:
    """The picture: one box a layer, one row a package, from the command line down."""
    parts, y = [], GAP
    for layer in layers()[1:]:
        top, y = y, y + GAP // 2
        rows = []
        for name in layer:
            shown = name + "/" if (SOURCE / name).is_dir() else name + ".py"
            lines = textwrap.wrap(said(name), LETTERS)
            rows.append(text(GAP * 2, y, shown, "name"))
            rows += [text(NAME, y + n * LINE, line, "what") for n, line in enumerate(lines)]
            y += LINE * max(1, len(lines))
        y += GAP // 2
        parts.append(f'<rect x="{GAP}" y="{top}" width="{WIDE - 2 * GAP}" height="{y - top}"/>')
        parts += rows
        y += GAP // 2
    return "\n".join((HEAD.format(width=WIDE, height=y + GAP // 2), *parts, "</svg>\n"))


def text(x: int, top: int, words: str, kind: str) -> str:
    return f'<text x="{x}" y="{top + 14}" class="{kind}">{escape(words)}</text>'


# (its own background, so that it can be read on a dark page)
HEAD = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">
<style>text {{ font: 13px sans-serif; fill: #1a202c }} .name {{ font: bold 13px monospace }}
rect {{ fill: #fff; stroke: #a0aec0 }}</style>
<rect width="{width}" height="{height}" style="fill: #f5f7fa; stroke: none"/>"""


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
