"""The command ``explain``. What is slow to import is imported where it is used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handcal.commands._device import (
    DeviceFile,
    ModelName,
    PriorsFile,
    before_of,
    contradictions,
)
from handcal.commands._options import (
    AS_IT_IS,
    Assume,
    Assumption,
    EffectsFrom,
    HeadingSigma,
    Height,
    Ignore,
    Json,
    Latitude,
    Reading,
    ReferenceExact,
    Report,
    Rrd,
    in_units,
    load,
    radians,
    reads_recordings,
    say_unused,
    with_own_effects,
)
from handcal.commands._precompile import compiled_ahead
from handcal.commands._progress import progress
from handcal.commands._registry import say
from handcal.interrupt import asked

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from handcal.explain import Explanation


@with_own_effects
@in_units
@reads_recordings
def explain(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Recordings of one device.")
    ],
    held_out: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE", help="Another recording of the device, for scoring only (repeatable)."
        ),
    ] = None,
    twin: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.mcap",
            help="Write the recording together with the readings that the baseline and the final "
            "model predict.",
        ),
    ] = None,
    write_effect: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.py",
            help="Write an error that was found without a name as an effect file, for "
            "--effects-from; further ones as FILE_2.py and so on. The name of the file "
            "becomes the effect's id.",
        ),
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            metavar="SECONDS",
            help="Time limit of the search. The result is the best model so far, with a list of "
            "what was not tried.",
        ),
    ] = None,
    device: DeviceFile = None,
    priors: PriorsFile = None,
    model: ModelName = None,
    heading_sigma: HeadingSigma = None,
    assume: Assumption = Assume.auto,
    latitude: Latitude = None,
    height: Height = 0.0,
    how: Reading = AS_IT_IS,
    ignore: Ignore = None,
    reference_exact: ReferenceExact = False,
    json: Json = None,
    report: Report = None,
    rrd: Rrd = None,
    effects_from: EffectsFrom = None,
) -> None:
    """Find the errors that a recording shows beyond biases: where, which physics, how certain.

    With --device, earlier sessions of the device are the prior of biases, and the values and
    sigmas of errors that are found combine all sessions. Ctrl-C ends the search with the best
    model so far, as --budget does. The exit status is 0 with every verdict.
    """
    from handcal.explain import explain as explained
    from handcal.output import beside, check_outputs

    read = (*files, *(held_out or ()), device, priors)
    _check_names(twin, write_effect)
    law = write_effect if write_effect and write_effect.parent.is_dir() else None
    check_outputs((json, report, rrd, twin, law), read)
    recordings = [load(path, how) for path in files]
    if twin:
        check_outputs(beside(twin, recordings), read)
    others = [load(path, how) for path in held_out or ()]
    settings: dict[str, Any] = {
        "heading_sigma": radians(heading_sigma), "latitude": radians(latitude), "height": height,
        "ignore": tuple(ignore or ()), "reference_exact": reference_exact,
    }  # fmt: skip
    say_unused(recordings, settings)
    before = before_of(device, priors, model, recordings)
    names = ", ".join(path.name for path in files)
    with (
        progress(f"explaining {names}") as done,
        compiled_ahead(),
        asked(done.announce) as stop,
    ):
        explanation = explained(
            recordings, others, assume=str(assume), budget=budget, stop=stop, before=before,
            progress=done, **settings,
        )  # fmt: skip
    explanation = _beside_the_device(explanation)
    typed = _typed(assume, heading_sigma, latitude, height, ignore, reference_exact, how,
                   device, held_out, budget, priors, model, effects_from)  # fmt: skip
    following = _following(explanation, files, typed, json)
    twins = beside(twin, recordings) if twin else ()
    _given_out(explanation, following, json, write_effect, report, rrd, twins)


def _given_out(
    explanation: Explanation, following: Sequence[str], json: Path | None,
    write_effect: Path | None, report: Path | None, rrd: Path | None, twins: Iterable[Path],
) -> None:  # fmt: skip
    """All files, first the one that cannot be made again from the others; then the output, whose
    reader may have had enough before its end."""
    from handcal.output import STANDARD_OUTPUT

    shown = str(json) == STANDARD_OUTPUT
    if json and not shown:
        _documented(explanation, json)
    if write_effect:
        _write(explanation, write_effect)
    _pictured(explanation, following, report, rrd, twins)
    if json and shown:
        _documented(explanation, json)
    else:
        _printed(explanation, following)


def _documented(explanation: Explanation, json: Path) -> None:
    """Write the JSON."""
    from handcal.show.calibration.summary import write_json
    from handcal.show.explanation.document import explanation_json

    write_json(explanation_json(explanation), json)


def _beside_the_device(explanation: Explanation) -> Explanation:
    """With a warning for each contradiction to what was known of the device."""
    said = contradictions(explanation.device, explanation.parameters, explanation.covariance)
    return replace(explanation, warnings=(*explanation.warnings, *said))


def _pictured(
    explanation: Explanation, following: Sequence[str], report: Path | None, rrd: Path | None,
    twins: Iterable[Path],
) -> None:  # fmt: skip
    """Write what was asked for besides numbers: page, Rerun file, a twin of each recording."""
    if report:
        from handcal.show.explanation.report import write_explanation_report

        write_explanation_report(explanation, report, following)
    if rrd:
        from handcal.show.dashboard import save_explanation_rrd

        save_explanation_rrd(explanation, rrd)
    for one, path in zip(explanation.recordings, twins, strict=False):
        from handcal.recordings.export import write_twin

        if one.twins is not None:
            write_twin(one.recording, *one.twins, path)


def _following(
    explanation: Explanation, files: Sequence[Path], typed: Sequence[str], json: Path | None
) -> list[str]:
    """The commands that come next, the same in the terminal and on the page."""
    from handcal.show.explanation.next_commands import commands

    written = "" if str(json) == "-" else str(json or "")
    return commands(explanation, [str(f) for f in files], typed, written)


def _printed(explanation: Explanation, following: Sequence[str]) -> None:
    """The explanation in the terminal, with the commands that come next."""
    from handcal.show.console import Terminal
    from handcal.show.explanation.terminal import print_explanation

    print_explanation(explanation, Terminal(), following)


def _typed(
    assume: Assume, heading_sigma: float | None, latitude: float | None, height: float,
    ignore: list[str] | None, reference_exact: bool, how: Reading,
    device: Path | None = None, held_out: list[Path] | None = None, budget: float | None = None,
    priors: Path | None = None, model: str | None = None, effects_from: Path | None = None,
) -> list[str]:  # fmt: skip
    """The options that say what is found, as they were typed."""
    out = [] if assume is Assume.auto else ["--assume", str(assume)]
    for name, value in (("--heading-sigma", heading_sigma), ("--latitude", latitude),
                        ("--height", height or None), ("--device", device),
                        ("--budget", budget), ("--priors", priors),
                        ("--model", model), ("--effects-from", effects_from)):  # fmt: skip
        out += [] if value is None else [name, str(value)]
    for name, values in (("--ignore", ignore), ("--held-out", held_out)):
        out += [word for value in values or () for word in (name, str(value))]
    return out + how.typed + (["--reference-exact"] if reference_exact else [])


def _check_names(twin: Path | None, write_effect: Path | None) -> None:
    """That what is asked for can be written under such names. Errors: InputError."""
    from handcal.recordings.export import check_ending

    if twin is not None:
        check_ending(twin)
    if write_effect is not None:
        _check_new(write_effect)


def _check_new(path: Path) -> None:
    """That an effect can be written there. Errors: InputError."""
    from keyword import iskeyword

    from handcal.effects import catalogue
    from handcal.types import InputError

    name = path.stem
    if path.suffix != ".py" or not name.isidentifier() or name.startswith("_") or iskeyword(name):
        raise InputError(
            f"--write-effect {path}: expected a name such as gyro_odd.py; it becomes an effect's "
            "id, so letters, digits and underscores."
        )
    if not (path.parent.is_dir() or path.parent.parent.is_dir()):
        raise InputError(f"--write-effect {path}: there is no folder {path.parent.parent}.")
    if name in catalogue():
        raise InputError(f"--write-effect {path}: there is an effect {name}; name another.")
    if path.exists():
        raise InputError(f"--write-effect {path}: that file exists; name another or remove it.")


def _write(explanation: Explanation, path: Path) -> None:
    from handcal.effects import catalogue
    from handcal.laws import law_file
    from handcal.show.explanation.words import lawless

    found = [u for u in explanation.unnamed if not lawless(u)]
    for u in explanation.unnamed:
        if u not in found:
            say(
                f"{u.formula} is an error that varies with the motion, not a law: it cannot be "
                "written as an effect file"
            )
    if not found:
        late = " (and time ran out before all was tried)" if explanation.untried else ""
        say(f"no law without a name was found{late}; {path} is not written")
        return
    names = [Path(r.recording.path).name for r in explanation.recordings]
    path.parent.mkdir(exist_ok=True)
    written = law_file.write(found, path, names, catalogue())
    for u, target in zip(found, written, strict=True):
        say(f"{target}: {u.formula}; edit it, and use it with --effects-from {target.parent}")
