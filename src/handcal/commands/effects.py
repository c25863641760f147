"""The command ``effects``. What is slow to import is imported where it is used."""

from __future__ import annotations

from typing import Annotated

import typer

from handcal.commands._options import Json, with_own_effects


@with_own_effects
def effects(
    id: Annotated[
        str | None, typer.Argument(metavar="[ID]", help="One effect; all of them if not given.")
    ] = None,
    json: Json = None,
) -> None:
    """The catalogue of errors: what each does, parameters, usual size, the motion that shows it."""
    from handcal.effects import catalogue, known_effect
    from handcal.output import check_outputs
    from handcal.show.calibration.summary import write_json
    from handcal.show.catalogue import effects_json, print_catalogue, print_effect

    check_outputs((json,))
    chosen = dict(catalogue()) if id is None else {id: known_effect(id)}
    if json:
        write_json(effects_json(chosen), json)
    if str(json) != "-":
        from handcal.show.console import Terminal

        if id is None:
            print_catalogue(chosen, Terminal())
        else:
            print_effect(chosen[id], Terminal())
