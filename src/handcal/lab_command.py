"""Laboratory methods: a known input, the gravity norm, the size effect, temperature; the papers.

The commands of ``handcal lab`` are the files ``lab/<name>_command.py``, found by listing.
"""

from __future__ import annotations

import pkgutil
from importlib.metadata import EntryPoint

import typer

from handcal import lab as methods
from handcal.commands import Commands

_ENDING = "_command"


class Methods(Commands):
    """One file in ``handcal.lab`` is one command."""

    def plugins(self) -> dict[str, EntryPoint]:
        """By name; nothing is imported."""
        names = (m.name for m in pkgutil.iter_modules(methods.__path__))
        stems = (n.removesuffix(_ENDING) for n in names if n.endswith(_ENDING))
        return {
            (name := stem.replace("_", "-")): EntryPoint(
                name, f"{methods.__name__}.{stem}{_ENDING}:{stem}", methods.__name__
            )
            for stem in sorted(stems)
        }


lab = typer.Typer(
    cls=Methods, add_completion=False, pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip


@lab.callback()
def _root() -> None:
    """Calibrate with a turntable, a cube or only a table, and repeat what the papers say."""
