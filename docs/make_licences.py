"""Writes docs/licences.md: what each dependency is licensed under; `make docs` runs it."""

from __future__ import annotations

import sys
from importlib.metadata import distribution
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "scripts"))
from dependencies import closure, direct, extras, package, plain  # noqa: E402

PAGE = ROOT / "docs" / "licences.md"
TEXT = """# Licences

*Reference.* handcal is under the MIT licence. The packages below are under their own licences; nothing of them is copied into handcal or altered. `make docs` writes this page from what the packages state, in the versions of `constraints.txt`.

## What `pip install .` brings

| package | licence | needed by |
|---|---|---|
{brought}

## What the extras add

| package | licence | extra |
|---|---|---|
{added}
"""  # noqa: E501


def stated() -> dict[str, str]:
    """Licences by plain name as the page has them, for extras that are not installed here."""
    if not PAGE.exists():
        return {}
    rows = [line.strip("| ").split(" | ") for line in PAGE.read_text("utf-8").splitlines()]
    return {plain(row[0]): row[1] for row in rows if len(row) == 3}


def page() -> str:
    """The page. Errors: LookupError where a dependency is neither installed nor on the page."""
    own = distribution("handcal")
    named = direct(own)
    found = closure(named)
    before = stated()
    brought, added = [], []
    for name, p in found.items():
        by = ["handcal"] * (name in named) + [q.name for q in found.values() if name in q.needs]
        brought.append(f"| {p.name} | {p.licence} | {', '.join(by)} |")
    for extra in extras(own):
        for name in direct(own, extra):
            one = package(name)
            if one is None and name not in before:
                raise LookupError(f"{name} is not installed here and its licence not on the page.")
            shown, licence = (one.name, one.licence) if one else (name, before[name])
            added.append(f"| {shown} | {licence} | {extra} |")
    return TEXT.format(brought="\n".join(brought), added="\n".join(added))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
