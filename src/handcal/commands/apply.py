"""The command ``apply``. What is slow to import is imported where it is used."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from handcal.commands._registry import say, tell

if TYPE_CHECKING:
    from handcal.device.apply import Corrected, Learnt


@with_own_effects
@reads_recordings
def apply(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording of the same device.")
    ],
    learnt_from: Annotated[
        Path,
        typer.Option(
            "--from",
            metavar="EXPLANATION.json",
            help="What `explain --json` or `calibrate --json` learnt, of this recording or others.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FILE.mcap", help="Recording to write.")
    ],
    biases: Annotated[
        bool,
        typer.Option(
            "--biases", help="Take off biases too, which are those of the recording explained."
        ),
    ] = False,
    anyway: Anyway = False,
    how: Reading = AS_IT_IS,
) -> None:
    """Take the errors that were found off a recording's readings.

    What is no error of a sensor (where it sits, gravity, noise) stays, and is said. So is what
    there is to doubt about the result, and where the recording seems to be of another device.
    """
    from handcal.device.another import another
    from handcal.device.apply import TOGETHER, not_shown
    from handcal.device.apply import apply as applied
    from handcal.output import check_outputs
    from handcal.recordings.export import check_ending, write_mcap
    from handcal.recordings.same_bag import bag_of, write_bag
    from handcal.types import HandcalError

    check_outputs((out,), (recording, learnt_from))
    check_ending(out)
    with learnt_in(learnt_from, anyway) as learnt:
        given = load(recording, how)
        bag = bag_of(recording, given)
        corrected = applied(given, learnt, biases=biases, in_place=bag is not None)
        unsure = not_shown(learnt)
    left = _left(corrected, learnt)
    if not corrected.taken:
        nothing = f"{learnt_from} has nothing that could be taken off {recording.name}"
        raise HandcalError(f"{nothing}. {left}" if left else f"{nothing}.")
    changed = tuple[str, ...]()
    if bag is None:
        write_mcap(corrected.recording, out)
    else:
        changed = write_bag(bag, given, corrected.recording, out)
    beside = f"{TOGETHER.format(', '.join(learnt.unnamed))}." if biases and learnt.unnamed else ""
    for sentence in (another(given, learnt), *given.warnings, *changed, left, unsure, beside):
        if sentence:
            say(sentence)
    tell(f"{out}: {', '.join(corrected.taken)} taken off {recording.name}")


def _left(corrected: Corrected, learnt: Learnt) -> str:
    """One sentence about what is left in the readings; empty if nothing is."""
    parts = [f"{', '.join(ids)} ({reason})" for reason, ids in corrected.left.items()]
    if learnt.unnamed:
        parts.append(f"{', '.join(learnt.unnamed)} (the model has no law of it)")
    return f"Left as it is: {'; '.join(parts)}." if parts else ""
