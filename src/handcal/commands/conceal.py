"""The command ``conceal``. What is slow to import is imported where it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from handcal.commands._options import (
    AS_IT_IS,
    Anyway,
    Reading,
    learnt_in,
    load,
    reads_recordings,
    with_own_effects,
)
from handcal.commands._registry import tell


@with_own_effects
@reads_recordings
def conceal(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording, real or simulated.")],
    effect: Annotated[
        list[str],
        typer.Option(
            metavar="ID=v,v,...",
            help="Effect to add, with values in the order of its parameters (repeatable). "
            "`handcal effects ID` lists them.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FILE.mcap", help="Recording to write.")
    ],
    learnt_from: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="EXPLANATION.json",
            help="Result of `explain --json` for this recording. The added error is then "
            "computed from the motion without the device's own errors.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Same seed, same file; random and printed if not given."),
    ] = None,
    anyway: Anyway = False,
    how: Reading = AS_IT_IS,
) -> None:
    """Add an effect to a recording, to see whether it is found."""
    import secrets

    import numpy as np

    from handcal.device import conceal as hidden
    from handcal.output import check_outputs
    from handcal.recordings.export import check_ending, write_mcap

    values = dict(hidden.parse(text) for text in effect)
    check_outputs((out,), (file, learnt_from))
    check_ending(out)
    seed = secrets.randbelow(2**31) if seed is None else seed
    recording = load(file, how)
    truth = None
    if learnt_from is not None:
        from handcal.device import apply as known

        with learnt_in(learnt_from, anyway) as learnt:
            truth = known.apply(recording, learnt, biases=True).recording.imu
    write_mcap(hidden.conceal(recording, values, np.random.default_rng(seed), truth), out)
    tell(f"{out}: {', '.join(values)} concealed in {Path(recording.path).name}, seed {seed}")
