"""What a session says on its way (biases as they close in) and at its end (the explanation)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from handcal.live.guide import next_turn
from handcal.live.session import Session
from handcal.live.sources.browser import Convention, told
from handcal.types import HandcalError, Recording

SHORTEST_S = 5.0
FILES = ("recording.mcap", "calibration.json", "explanation.json", "report.html")
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Ended:
    """What is held at the end: headline and sentences of the verdict, and the files' names."""

    headline: str
    sentences: tuple[str, ...]
    files: tuple[str, ...]

    @property
    def document(self) -> dict[str, Any]:
        """As the page is told."""
        return {"headline": self.headline, "sentences": self.sentences, "files": self.files}


def with_convention(recording: Recording, found: Convention) -> Recording:
    """The recording with the axes and the sign that its turns and its first rest have told."""
    imu = recording.imu
    gyro = np.ascontiguousarray(imu.gyro[:, list(found.order)])
    return replace(recording, imu=replace(imu, gyro=gyro, accel=found.sign * imu.accel))


def settled(recording: Recording, checked: bool) -> tuple[Recording, tuple[str, ...]]:
    """The recording as it is to be read, and what was changed. checked: it is from a browser."""
    imu = recording.imu
    found = told(imu.t, imu.gyro, imu.accel) if checked else Convention()
    if found is None:
        return recording, ("It was turned too little to tell the browser's axes: a guess.",)
    return with_convention(recording, found), found.sentences


def look(session: Session, checked: bool) -> None:
    """Renew what the session tells of biases and of the turn to do next."""
    recording = session.recording()
    told_now: dict[str, Any] = {"turn": next_turn(recording)}
    if recording is not None and recording.duration_s > SHORTEST_S:
        recording, _ = settled(recording, checked)
        told_now["turn"] = next_turn(recording)
        biases = _biases(recording)
        if biases:
            told_now["biases"] = biases
    session.told |= told_now


def _biases(recording: Recording) -> list[dict[str, Any]]:
    """Of each axis what the gyro and the accelerometer read too much, with sigma, as shown."""
    from handcal.estimate.calibration import calibrate

    try:
        result = calibrate(recording)
    except HandcalError:  # (too little yet; the next look may have more)
        return []
    units = {"gyro_bias": (np.degrees(1.0), "deg/s"), "accel_bias": (1.0, "m/s²")}
    return [
        {
            "name": f"{p.effect.split('_')[0]} {p.name}",
            "value": p.value * units[p.effect][0],
            "sigma": p.sigma * units[p.effect][0],
            "prior": p.prior_sigma * units[p.effect][0],
            "unit": units[p.effect][1],
        }
        for p in result.parameters
        if p.effect in units
    ]


def finish(session: Session, out: Path, checked: bool, budget: float | None,
           progress: Progress, warnings: tuple[str, ...] = ()) -> Ended:  # fmt: skip
    """Write the recording whole, explain it, calibrate with what was found, write it all.

    The explanation is made of the file as it was written, so `handcal explain` says the same.
    warnings: what is to be said of the recording besides, in results and report.
    Errors: HandcalError where nothing can be made of it; the recording stays.
    """
    from handcal.recordings.export import write_mcap
    from handcal.recordings.inputs import load

    recording = session.recording()
    session.recorder.close()
    if recording is None:
        session.recorder.path.unlink(missing_ok=True)
        raise HandcalError("Nothing arrived, so nothing was recorded.")
    recording, said = settled(recording, checked)
    write_mcap(recording, out / FILES[0])
    written = load(out / FILES[0])
    written = replace(written, warnings=(*written.warnings, *warnings))
    headline, sentences = _explained(written, out, budget, progress)
    return Ended(headline, (*said, *sentences, *warnings), FILES)


def _explained(
    recording: Recording, out: Path, budget: float | None, progress: Progress
) -> tuple[str, tuple[str, ...]]:
    from handcal.estimate.calibration import calibrate
    from handcal.explain import explain
    from handcal.show.calibration.summary import calibration_json, write_json
    from handcal.show.explanation import verdict_text
    from handcal.show.explanation.document import explanation_json
    from handcal.show.explanation.next_commands import commands
    from handcal.show.explanation.report import write_explanation_report

    def report(fraction: float | None = None, stage: str = "") -> None:
        if fraction is not None:
            progress(0.9 * fraction, stage)

    explanation = explain([recording], budget=budget, progress=report)
    write_json(explanation_json(explanation), out / FILES[2])
    following = commands(explanation, [str(out / FILES[0])], json=str(out / FILES[2]))
    write_explanation_report(explanation, out / FILES[3], following)
    progress(0.9, "calibrating with what was found")
    result = calibrate(recording, [m.effect for m in explanation.missing])
    write_json(calibration_json(result), out / FILES[1])
    verdict = verdict_text.verdict(explanation)
    return verdict.headline, tuple(verdict.sentences)
