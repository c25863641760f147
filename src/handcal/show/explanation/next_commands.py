"""What to do with an explanation: the parameters to take off, and the commands that come next."""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Sequence
from pathlib import Path

from handcal.device.apply import BIASES_TOO, removable
from handcal.device.file import kept
from handcal.effects import catalogue, installed
from handcal.explanation import Explanation
from handcal.exports import of_vehicle
from handcal.show.explanation.document import final_parameters
from handcal.show.explanation.words import lawless
from handcal.types import Parameter, Recording

# Options of ``explain`` that ``apply`` has too, that go with ``calibrate --from``, and that go with
# ``calibrate --effects``.
READS = ("--topic", "--units")
REPEATS = (*READS, "--device")
CALIBRATES = (*REPEATS, "--assume", "--heading-sigma", "--latitude", "--height", "--ignore",
              "--reference-exact")  # fmt: skip

# The one that has a folder of one's own effects.
OWN = ("--effects-from",)
# Default names of a device file and of a folder of laws.
DEVICE = "my-device.toml"
LAWS = "my-effects"
# Of the files that other programs load.
ENDINGS = {"px4": ".params", "ardupilot": ".param", "ros2": ".yaml"}


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
    """Lines to copy into a terminal: repeat what was found, take it off, give it to the
    program that the recording is from, and keep it for the device's next recording.

    files: the recordings as typed; options: of ``explain``, as typed; json: where the explanation
    was written. Where it was not, it is made again with ``--json`` first: only the file holds what
    was assumed of the hand, and which readings were left out. Of a fit that deserves no trust,
    none.
    """
    if e.impossible:
        return []
    paths = list(files) or [r.recording.path for r in e.recordings]
    first = Path(paths[0])
    folder, options = _known_to(options, OWN), _known_to(options, OWN, others=True)
    needed = any(i not in installed() for i in named(e))
    own = (folder or [*OWN, "DIR"]) if needed else []
    out = []
    if not json:
        json = f"{first.stem}-explanation.json"
        out = [["handcal", "explain", *paths, *options, *own, "--json", json]]
    if e.model is None:
        learnt = ["--effects", ",".join(named(e))] if named(e) else []
        learnt += _known_to(options, CALIBRATES)
    else:
        learnt = ["--from", json, *_known_to(options, REPEATS)]
    report = ["--report", f"{first.stem}-calibration.html"]
    out.append(["handcal", "calibrate", *paths, *learnt, *own, *report])
    if any(removable(m.effect, e.recordings[0].recording) for m in e.missing):
        corrected = ["--from", json, *_known_to(options, READS), *own]
        corrected += ["-o", f"{first.stem}-corrected.mcap"]
        out.append(["handcal", "apply", str(first), *corrected])
    if form := _format(e.recordings[0].recording):
        reads = ["--recording", str(first), *_known_to(options, READS), *own]
        file = f"{first.stem}-calibration{ENDINGS[form]}"
        out.append(["handcal", "export", json, "--to", form, *reads, "-o", file])
    if any(not lawless(u) for u in e.unnamed):
        name = re.sub(r"\W", "_", first.stem, flags=re.ASCII)
        file, again = f"{LAWS}/law_of_{name}.py", [*paths, *options]
        out.append(["handcal", "explain", *again, *own, "--write-effect", file])
        out.append(["handcal", "explain", *again, "--effects-from", LAWS, "--json", json])
    if any(kept((p.effect, p.name)) for m in e.missing for p in m.parameters):
        device = [*_known_to(options, ("--device",))[1:], DEVICE][0]
        out.append(["handcal", "device", "add", device, json])
    return [shlex.join(words) for words in out]


def _format(recording: Recording) -> str:
    """Of whose program a recording is: an autopilot or ROS 2; "" for others."""
    topic = recording.topics.get("imu", "")
    # (handcal's own recordings are bags too, with this topic)
    own = Path(recording.path).suffix == ".mcap" and topic == "/imu"
    return of_vehicle(recording) or ("ros2" if topic.startswith("/") and not own else "")


def beside(following: Sequence[str]) -> str:
    """A sentence about an option that the commands do not have; empty where there is none."""
    return BIASES_TOO if any(line.startswith("handcal apply ") for line in following) else ""


def _known_to(options: Sequence[str], names: Collection[str], *, others: bool = False) -> list[str]:
    """Those of the options as typed that another command takes, each with its value; or all
    others."""
    out: list[str] = []
    taken = False
    for word in options:
        taken = (word in names) != others if word.startswith("--") else taken
        out += [word] if taken else []
    return out
