"""Writes the table of constants into docs/explain.md, from the code; `make docs` runs it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

FILE = Path(__file__).with_name("explain.md")
SOURCE = Path(__file__).parent.parent / "src" / "handcal"
# Where a decision about a recording may hang on a number.
FOLDERS = ("explain", "search", "laws", "estimate")
FILES = ("model_score.py", "recordings/segment.py")
BEGIN, END = "<!-- constants: written by make docs -->\n", "<!-- end of constants -->\n"


@dataclass(frozen=True)
class Constant:
    """A number of the code: where it stands, its value as written, and the comment above it."""

    file: str
    name: str
    value: str
    comment: str


def constants() -> list[Constant]:
    """Every constant that is a number, or several."""
    paths = [p for folder in FOLDERS for p in sorted((SOURCE / folder).rglob("*.py"))]
    return [c for p in (*paths, *(SOURCE / f for f in FILES)) for c in _of(p)]


def _of(path: Path) -> Iterator[Constant]:
    text = path.read_text()
    lines = text.splitlines()
    # several in a row share the comment above the first
    last, said = -1, ""
    for node in ast.parse(text).body:
        if not isinstance(node, ast.Assign) or not _number(node.value):
            continue
        target = _several(node.targets[0])
        if not target.isupper() and not target.replace(", ", "").isupper():
            continue
        above = _above(lines, node.lineno - 1)
        said = above or (said if node.lineno - 1 == last else "")
        last = node.end_lineno or node.lineno
        name = str(path.relative_to(SOURCE))
        yield Constant(name, target, _several(node.value), said)


def _several(value: ast.expr) -> str:
    """An expression as written; of several, without the parentheses around all."""
    text = ast.unparse(value)
    return text[1:-1] if isinstance(value, ast.Tuple) else text


def _above(lines: list[str], row: int) -> str:
    found: list[str] = []
    while row > 0 and lines[row - 1].startswith("#"):
        row -= 1
        found.insert(0, lines[row].lstrip("# "))
    return " ".join(found)


def _number(node: ast.expr) -> bool:
    """Whether an expression is made of numbers alone, and functions of these."""
    names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
    if any(isinstance(n, ast.Constant) and isinstance(n.value, str) for n in ast.walk(node)):
        return False
    numbers = any(
        isinstance(n, ast.Constant) and isinstance(n.value, int | float) for n in ast.walk(node)
    )
    return numbers and all(n in ("np", "math", "float") or n.isupper() for n in names)


def table() -> str:
    """The table as Markdown."""
    rows = ["| where | constant | value | what it is |", "|---|---|---|---|"]
    rows += [
        f"| `{c.file}` | `{c.name}` | `{c.value}` | {c.comment.replace('|', chr(92) + '|')} |"
        for c in constants()
    ]
    return "\n".join(rows) + "\n"


def page() -> str:
    """docs/explain.md with the table as it should be."""
    head, rest = FILE.read_text().split(BEGIN)
    return head + BEGIN + "\n" + table() + "\n" + END + rest.split(END)[1]


if __name__ == "__main__":
    FILE.write_text(page())
