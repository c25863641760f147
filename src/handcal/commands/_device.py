"""The options --device and --priors: what a file says before a recording, and what to say of it
afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handcal.commands._registry import say

if TYPE_CHECKING:
    from handcal.types import Array, Parameter, Prior, Recording

DeviceFile = Annotated[
    Path | None,
    typer.Option(
        "--device",
        metavar="PHONE.toml",
        help="Prior from earlier sessions of this device (a file of `handcal device add`).",
    ),
]
PriorsFile = Annotated[
    Path | None,
    typer.Option(
        "--priors",
        metavar="FILE.toml",
        help="Prior from other devices of this model (a file of `handcal fleet`).",
    ),
]
ModelName = Annotated[
    str | None,
    typer.Option(
        "--model", metavar="NAME", help="Phone model in the --priors file, if it has several."
    ),
]


def before_of(
    device: Path | None, priors: Path | None, model: str | None, recordings: Sequence[Recording]
) -> Prior | None:
    """What a device file or a file of priors says before these recordings. Errors: InputError."""
    if priors is None:
        if model is not None:
            from handcal.types import InputError

            raise InputError("--model selects a model of a priors file: give --priors FILE too.")
        return known_before(device, recordings)
    from handcal.device.priors import chosen, prior, read
    from handcal.types import InputError

    if device is not None:
        raise InputError("--device and --priors both set the prior: give one of them.")
    learned = read(priors)
    return prior(learned, chosen(learned, model))


def known_before(file: Path | None, recordings: Sequence[Recording]) -> Prior | None:
    """What the file says before these recordings, which do not count twice; none: before one that
    is about to be made. Errors: InputError."""
    if file is None:
        return None
    from dataclasses import replace
    from datetime import UTC, datetime

    from handcal.device import file as device_file
    from handcal.device.history import disagreements, prior
    from handcal.show.calibration.summary import digest, mean_temperature
    from handcal.show.device import difference_sentence
    from handcal.types import InputError

    device = device_file.read(file)
    own = {digest(Path(r.path)) for r in recordings}
    others = tuple(s for s in device.sessions if not own & set(s.sha256))
    if len(others) < len(device.sessions):
        say(f"{file} holds a session of this recording already; it is not counted twice")
        device = replace(device, sessions=others)
    if not others:
        raise InputError(
            f"{file} holds no session of another recording of the device: run without --device."
        )
    for d in disagreements(device):
        say(difference_sentence(d, device))
    begun = min((r.start_ns for r in recordings if r.start_ns), default=0)
    when = datetime.fromtimestamp(begun / 1e9, UTC) if begun else datetime.now(UTC)
    warmth = mean_temperature(recordings[0]) if recordings else None
    return prior(device, when, warmth, str(file))


def contradictions(
    before: Prior | None, parameters: Sequence[Parameter], covariance: Array | None
) -> tuple[str, ...]:
    """Warnings where a result contradicts what was known of the device; none without --device."""
    if before is None or covariance is None or "priors" in before.source:
        return ()
    from handcal.show.device import surprise_sentences

    return surprise_sentences(before, parameters, covariance)
