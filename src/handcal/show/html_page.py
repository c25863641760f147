"""Pages from templates."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def page(template: str, context: dict[str, Any]) -> str:
    """A page of the templates, filled in; text is escaped, names must be known."""
    import jinja2

    loader = jinja2.FileSystemLoader(Path(__file__).with_name("templates"))
    environment = jinja2.Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    return environment.get_template(template).render(**context)
