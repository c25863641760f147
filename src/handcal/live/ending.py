"""The end of a session: the recording whole, explained, calibrated, exported."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from handcal.live import part
from handcal.live.goals import said_of
from handcal.live.rounding import TOO_SURE, rounded
from handcal.live.session import Session
from handcal.live.sources.browser import APIS, Convention, told
from handcal.recordings.export import Pieces
from handcal.trust import check, together
from handcal.types import Array, HandcalError, Parameter, Prior, Recording

FILES = ("recording.mcap", "calibration.json", "explanation.json", "report.html")
# What a calibration is written as besides, in a folder of its own: format, name of the file.
EXPORTS = (
    ("python", "correction.py"), ("c", "correction.h"), ("csv", "calibration.csv"),
    ("ros2", "ros2.yaml"), ("kalibr", "kalibr.yaml"), ("openvins", "openvins.yaml"),
)  # fmt: skip
EXPORTED = "exports"
# Slower than this, Hz, is the 60 Hz of browsers, not what the sensor could do.
BROWSER_HZ = 70.0
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Wanted:
    """What was asked for.

    effects: to calibrate, instead of those that are found; before: what is known of the device;
    until: sigmas, SI, by effect; budget: s; checked: axes and sign are a browser's, to be told by
    turns and the first rest; renewed: what is known before the recording, by when it was made;
    stop: says whether to end the search with what it has; typed: the options that say so; anyway:
    export also what is not to be trusted.
    """

    effects: tuple[str, ...] = ()
    before: Prior | None = None
    until: dict[str, float] = field(default_factory=dict)
    budget: float | None = None
    checked: bool = False
    renewed: Callable[[Recording], Prior | None] | None = None
    stop: Callable[[], bool] | None = None
    typed: tuple[str, ...] = ()
    anyway: bool = False


@dataclass(frozen=True)
class Ended:
    """What is held at the end: headline and sentences of the verdict, the files' names, and what
    explanation and calibration warn of."""

    headline: str
    sentences: tuple[str, ...]
    files: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    @property
    def document(self) -> dict[str, Any]:
        """As the page is told."""
        return {"headline": self.headline, "sentences": self.sentences, "files": self.files,
                "warnings": self.warnings}  # fmt: skip


def with_convention(recording: Recording, found: Convention) -> Recording:
    """The recording with the axes and the sign that its turns and its first rest have told."""
    imu = recording.imu
    gyro = np.ascontiguousarray(imu.gyro[:, list(found.order)])
    return replace(recording, imu=replace(imu, gyro=gyro, accel=found.sign * imu.accel))


def put_right(pieces: Pieces, found: Convention) -> Pieces:
    """The same of a batch."""
    if "imu" not in pieces:
        return pieces
    ns, value = pieces["imu"]
    righted = np.hstack([value[:, list(found.order)], found.sign * value[:, 3:]])
    return {**pieces, "imu": (ns, righted)}


def settled(
    recording: Recording, checked: bool, page: bool = True
) -> tuple[Convention, tuple[str, ...]]:
    """How the recording is to be read, and what is to be said of it. checked: its axes and sign
    are to be told by turns and rest; page: it is from a browser."""
    imu = recording.imu
    if not checked:
        return Convention(), ()
    found = told(imu.t, imu.gyro, imu.accel)
    if found is None:
        said = "It was turned too little to tell the axes: they are a guess."
        return Convention(), (said,)
    return found, (*found.sentences, *(browsers_limits(recording) if page else ()))


def browsers_limits(recording: Recording) -> Iterator[str]:
    """What cannot be learnt of these readings, because of what browsers do with them."""
    imu = recording.imu
    gyro = np.degrees(imu.gyro)
    if rounded(recording):
        yield (
            "This browser rounds to 0.1 deg/s or 0.1 m/s²: biases and scale errors can be learnt "
            f"all the same, but to {TOO_SURE:.0f} times the sigmas that are given; noise levels "
            "are those of the rounding."
        )
    if recording.rate_hz < BROWSER_HZ:
        yield (
            f"This browser gives {recording.rate_hz:.0f} readings a second: what fast turns and "
            "delays show of the sensors is not in them."
        )
    rest = imu.t < 2.0
    if rest.any() and float(np.abs(gyro[rest].mean(axis=0)).max()) < 0.01:
        yield (
            "The gyro reads zero at rest: the system takes its bias off (iOS does), so the bias "
            "here is what is left of it, not the sensor's own."
        )


def finish(session: Session, out: Path, wanted: Wanted, progress: Progress) -> Ended:
    """Write the recording whole, explain it, calibrate with what was found, write it all.

    The explanation is made of the file as it was written, so `handcal explain` says the same.
    Errors: HandcalError where nothing can be made of it; the recording stays.
    """
    from handcal.recordings.inputs import load

    session.recorder.close()
    long = session.recorder.seconds > part.EXPLAINED_S
    name, said = (_in_part if long else _as_a_whole)(session, out, wanted)
    written = load(out / name)
    written = replace(written, warnings=(*written.warnings, *said))
    if wanted.renewed is not None:
        wanted = replace(wanted, before=wanted.renewed(written))
    if session.source != "file" and session.clocks.sentence:
        said = (*said, session.clocks.sentence)
    said = (*said, *filter(None, [APIS.get(session.note.get("api", ""))]))
    ended = _explained(written, out, wanted, progress)
    return replace(
        ended, sentences=(*ended.sentences, *said),
        files=(*dict.fromkeys((*FILES, name)), *ended.files),
        warnings=tuple(w for w in ended.warnings if w not in said),
    )  # fmt: skip


def _as_a_whole(session: Session, out: Path, wanted: Wanted) -> tuple[str, tuple[str, ...]]:
    """Write the recording; its name, and what is to be said of it."""
    from handcal.recordings.export import write_mcap

    recording = _whole(session)
    found, said = settled(recording, wanted.checked, session.source == "page")
    write_mcap(with_convention(recording, found), out / FILES[0])
    return FILES[0], said


def _in_part(session: Session, out: Path, wanted: Wanted) -> tuple[str, tuple[str, ...]]:
    """Write a recording of hours piece by piece, and beside it the part that is explained; that
    one's name, and what is to be said."""
    from handcal.recordings.export import write_mcap

    path = session.recorder.path
    begun = part.beginning(path)
    assert begun is not None  # (it has lasted)
    found, said = settled(begun, wanted.checked, session.source == "page")

    def change(pieces: Pieces) -> Pieces:
        return put_right(pieces, found)

    most = part.between(path, *part.most_turned(path), change)
    assert most is not None
    write_mcap(most, out / part.NAME)
    part.rewritten(path, change)
    minutes = session.recorder.seconds / 60.0
    return part.NAME, (
        f"It lasted {minutes:.0f} minutes: what is explained is the {part.EXPLAINED_S / 60.0:.0f} "
        f"in which it was turned most ({part.NAME}).",
        *said,
    )


def _whole(session: Session) -> Recording:
    """All that was recorded. Errors: HandcalError where nothing was."""
    from handcal.live.session import recording_of
    from handcal.recordings.append import held

    path = session.recorder.path
    recording = recording_of(path, {"imu": _nothing(), **held(path).streams})
    if recording is None:
        path.unlink(missing_ok=True)
        raise HandcalError("Nothing arrived, so nothing was recorded.")
    return recording


def _nothing() -> Any:
    return np.zeros(0, dtype=np.int64), np.zeros((0, 6))


def _explained(recording: Recording, out: Path, wanted: Wanted, progress: Progress) -> Ended:
    """Explain and calibrate; of what is written the exports are told as files."""
    from handcal.estimate.calibration import calibrate
    from handcal.explain import explain
    from handcal.show import doubts
    from handcal.show.calibration.summary import calibration_json, write_json
    from handcal.show.explanation import verdict_text
    from handcal.show.explanation.document import all_warnings, explanation_json
    from handcal.show.explanation.next_commands import commands
    from handcal.show.explanation.report import write_explanation_report

    def report(fraction: float | None = None, stage: str = "") -> None:
        if fraction is not None:
            progress(0.9 * fraction, stage)

    explanation = explain(
        [recording], budget=wanted.budget, stop=wanted.stop, before=wanted.before, progress=report
    )
    more = _contradicting(wanted, explanation.parameters, explanation.covariance)
    explanation = replace(explanation, warnings=(*explanation.warnings, *more))
    write_json(explanation_json(explanation), out / FILES[2])
    following = commands(explanation, [recording.path], wanted.typed, str(out / FILES[2]))
    write_explanation_report(explanation, out / FILES[3], following)
    progress(0.9, "calibrating with what was found")
    effects = wanted.effects or [m.effect for m in explanation.missing]
    result = calibrate(recording, effects, before=wanted.before)
    more = _contradicting(wanted, result.parameters, result.covariance)
    result = replace(result, warnings=(*result.warnings, *more))
    write_json(calibration_json(result), out / FILES[1])
    verdict = verdict_text.verdict(explanation)
    said = (*verdict.sentences, *said_of(result.parameters, wanted.until))
    # (what is calibrated is what was found, so a doubt about either is one about both)
    own = together((doubts.of_explanation(explanation), doubts.of_calibration(result)))
    warnings = dict.fromkeys((*all_warnings(explanation), *result.warnings, *own.reasons))
    try:
        check(FILES[1], own, wanted.anyway)
    except HandcalError as error:
        return Ended(verdict.headline, said, (), (*warnings, str(error)))
    return Ended(verdict.headline, said, tuple(exported(out, wanted.anyway)), tuple(warnings))


def _contradicting(
    wanted: Wanted, parameters: Sequence[Parameter], covariance: Array | None
) -> tuple[str, ...]:
    """Where what is found contradicts what a device file says; a file of priors is of others."""
    if wanted.before is None or covariance is None or "priors" in wanted.before.source:
        return ()
    from handcal.show.device import surprise_sentences

    return surprise_sentences(wanted.before, parameters, covariance)


def exported(out: Path, anyway: bool = False) -> Iterator[str]:
    """Write the calibration in other programs' formats; the names of what could be written.
    anyway: also of one that is not to be trusted."""
    from handcal import output
    from handcal.exports import format_of
    from handcal.exports._contents import contents

    (out / EXPORTED).mkdir(exist_ok=True)
    for form, name in EXPORTS:
        try:
            text = format_of(form).write(contents(out / FILES[1], format_of(form), anyway=anyway))
        except HandcalError:  # (a format that cannot hold what was found)
            continue
        output.write_text(out / EXPORTED / name, text)
        yield f"{EXPORTED}/{name}"
