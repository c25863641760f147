"""The command ``apply``. What is slow to import is imported where it is used."""

from __future__ import annotations

from dataclasses import replace
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
    from handcal.types import Recording


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
            help="Result of `explain --json` or `calibrate --json`, of this or another recording "
            "of the device.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FILE.mcap", help="Recording to write.")
    ],
    biases: Annotated[
        bool,
        typer.Option(
            "--biases",
            help="Remove biases too. They are those of the recording that was explained.",
        ),
    ] = False,
    anyway: Anyway = False,
    how: Reading = AS_IT_IS,
) -> None:
    """Correct a recording: remove the errors that were found from its readings.

    Only sensor errors are removed. The sensor's position, gravity and noise stay, and are listed.
    Warnings say what makes the result doubtful, and whether the recording seems to be of another
    device.
    """
    from handcal.device.another import check_corrected, unlike
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
        check_corrected(given, learnt, anyway)
        bag = bag_of(recording, given)
        corrected = applied(given, learnt, biases=biases, in_place=bag is not None)
        unsure, laws = not_shown(learnt), _laws(given, learnt, corrected, biases)
    left = _left(corrected, learnt)
    if not corrected.taken:
        nothing = f"{learnt_from} has no error that could be removed from {recording.name}"
        raise HandcalError(f"{nothing}. {left}" if left else f"{nothing}.")
    changed = tuple[str, ...]()
    if bag is None:
        write_mcap(corrected.recording, out)
    else:
        changed = write_bag(bag, given, corrected.recording, out)
    beside = f"{TOGETHER.format(', '.join(learnt.unnamed))}." if biases and learnt.unnamed else ""
    for sentence in (
        *unlike(given, learnt),
        *given.warnings,
        *changed,
        _beside(corrected, learnt),
        laws,
        left,
        unsure,
        beside,
    ):
        if sentence:
            say(sentence)
    tell(f"{out}: {', '.join(corrected.taken)} removed from {recording.name}")


def _laws(given: Recording, learnt: Learnt, corrected: Corrected, biases: bool) -> str:
    """One sentence about how much each law without a name changed the readings; empty if none."""
    from handcal.device.apply import apply as applied
    from handcal.exports._header import readings, rms, sized

    done, parts = readings(corrected.recording), []
    for law in (i for i in corrected.taken if " += " in i):
        others = {i: v for i, v in learnt.values.items() if i != law}
        rest = readings(applied(given, replace(learnt, values=others), biases=biases).recording)
        size = rms(done - rest) if rest.shape == done.shape else None
        if size is None or any(size):  # (else it is a law of another stream)
            parts.append(f"{law}: {sized(size)}")
    return f"Laws without a name that were removed: {'; '.join(parts)}." if parts else ""


def _beside(corrected: Corrected, learnt: Learnt) -> str:
    """One sentence about errors that were taken off though an explanation did not find them."""
    from handcal.device.apply import BIASES

    if learnt.found is None:
        return ""
    others = [i for i in corrected.taken if i not in (*BIASES, *learnt.found)]
    if not others:
        return ""
    return (
        "All errors that were shown are removed. These were estimated, but not found to be "
        f"missing: {', '.join(others)}."
    )


def _left(corrected: Corrected, learnt: Learnt) -> str:
    """One sentence about what is left in the readings; empty if nothing is."""
    parts = [f"{', '.join(ids)} ({reason})" for reason, ids in corrected.left.items()]
    if learnt.unnamed:
        parts.append(f"{', '.join(learnt.unnamed)} (the model has no law for it)")
    return f"Not removed: {'; '.join(parts)}." if parts else ""
