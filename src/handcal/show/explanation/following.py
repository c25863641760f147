"""What to do with an explanation: the parameters to take off, and the commands that come next."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from handcal.effects import catalogue, installed
from handcal.explain.explanation import Explanation
from handcal.show.explanation.document import final_parameters
from handcal.types import Parameter

# What stands for a file that the explanation was not written to.
JSON = "explanation.json"


def named(e: Explanation) -> list[str]:
    """Ids of the effects that are missing and can be asked for, as the explanation lists them."""
    known = catalogue()
    return [m.effect for m in e.missing if m.effect in known and not known[m.effect].always]


def applicable(e: Explanation) -> list[Parameter]:
    """Parameters of the final model; of several recordings with the biases of the first."""
    if len(e.recordings) < 2:
        return final_parameters(e)
    found = {(p.effect, p.name): p for p in (*e.parameters, *e.recordings[0].parameters)}
    return list(found.values())


def biases_of(e: Explanation) -> str:
    """Of which recording the biases in ``applicable`` are, if there are several; else empty."""
    if len(e.recordings) < 2:
        return ""
    return f"The biases are those of {Path(e.recordings[0].recording.path).name}."


def commands(
    e: Explanation, files: Sequence[str] = (), options: Sequence[str] = (), json: str = ""
) -> list[str]:
    """Lines to copy into a terminal: calibrate with what was found, and take it off.

    files: the recordings as typed; options: of ``explain`` that ``calibrate`` shares, as typed;
    json: where the explanation was written, if anywhere.
    """
    paths = list(files) or [r.recording.path for r in e.recordings]
    ids = named(e)
    own = ["--effects-from", "DIR"] if any(i not in installed() for i in ids) else []
    asked = ["--effects", ",".join(ids)] if ids else []
    first = Path(paths[0])
    calibrate = ["handcal", "calibrate", *paths, *asked, *options, *own]
    out = [[*calibrate, "--report", f"{first.stem}-calibration.html"]]
    if ids:
        corrected = f"{first.stem}-corrected.mcap"
        out.append(["handcal", "apply", str(first), "--from", json or JSON, *own, "-o", corrected])
    return [shlex.join(words) for words in out]
