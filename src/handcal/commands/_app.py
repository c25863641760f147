"""The command line: ``handcal COMMAND``. Everything slow is imported where it is used.

Exit status: 0 done; 1 no result (a sentence says why); 2 wrong use or unreadable
input; 130 interrupted.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Annotated

import typer

from handcal.commands._later import put_off
from handcal.commands._registry import Commands, run
from handcal.compiled import memory

app = typer.Typer(
    cls=Commands, pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip


def _version(wanted: bool) -> None:
    if wanted:
        from handcal import __version__

        print(f"handcal {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001 (its callback does it)
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say which version.")
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="HANDCAL.toml",
            help="Default options, a section for each command; the command line wins.",
        ),
    ] = None,
) -> None:
    """Calibrate cheap inertial sensors while they are simply turned in the hand."""
    if config is not None:
        from handcal import output
        from handcal.commands._config import defaults

        context.default_map = defaults(config, context)
        context.with_resource(output.not_over([config]))


def main() -> None:
    """The ``handcal`` command. Leaves by SystemExit."""
    # Before numpy is imported: threads on matrices of a hundred rows cost more than they bring.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # (of a cache that it could not keep, a font that is not there: nothing that anybody asked)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    memory.kept()
    put_off()
    run(app)


if __name__ == "__main__":
    main()
