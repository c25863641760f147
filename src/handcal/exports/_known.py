"""What a result file holds, sorted by what matrices can hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from handcal.device import apply as device
from handcal.device.apply import BIASES, Learnt
from handcal.documents import read_json
from handcal.effects import catalogue
from handcal.exports import _correction as correction
from handcal.exports._text import one_line
from handcal.trust import of_document, said
from handcal.types import Array, Recording


@dataclass(frozen=True)
class Known:
    """A result, sorted by what matrices can hold.

    matrices: E (6, 6) and c (6,) of each effect that is one; others: ids of errors of gyro and
    accelerometer that are none; elsewhere: ids of what is no error of these two sensors.
    """

    learnt: Learnt
    document: Mapping[str, Any]
    bias: Array
    bias_sigma: Array
    bias_from: str
    hidden: Mapping[str, str]
    matrices: Mapping[str, tuple[Array, Array]]
    others: tuple[str, ...]
    elsewhere: tuple[str, ...]

    def of_readings(self) -> dict[str, Array]:
        """Values of the effects that are errors of gyro and accelerometer."""
        kept = {*self.matrices, *self.others}
        return {i: v for i, v in self.learnt.values.items() if i in kept}


def known(path: Path, recording: Recording | None) -> Known:
    """What a result file says. Errors: InputError; HandcalError where matrices would be wrong."""
    document = read_json(path)
    learnt = device.of_document(str(path), document)
    said = ", ".join(Path(str(r["path"])).name for r in recordings_of(document))
    bias, words, hidden = _bias(learnt, recording, said)
    matrices: dict[str, tuple[Array, Array]] = {}
    others: list[str] = []
    elsewhere: list[str] = []
    for i, values in learnt.values.items():
        effect = catalogue()[i]
        made = correction.as_matrix(effect, values)
        if made is not None:
            matrices[i] = made
        else:
            (others if effect.misreads else elsewhere).append(i)
    held = {i: learnt.values[i] for i in matrices}
    correction.check(correction.together(list(matrices.values()), bias), held, bias)
    sigma = _bias_sigma(document, recording)
    return Known(learnt, document, bias, sigma, words, hidden, matrices, (*others, *learnt.unnamed),
                 tuple(elsewhere))  # fmt: skip


def _bias(
    learnt: Learnt, recording: Recording | None, said: str
) -> tuple[Array, str, dict[str, str]]:
    """Biases (6,), of which recording in words, and their axes that were not shown.

    said: the recordings, for a result that does not say of which its biases are."""
    found = list(learnt.biases)
    if recording is not None and len(found) > 1:
        own = [b for b in found if Path(b[0]).name == Path(recording.path).name]
        found = own or found
    if not found:
        return np.zeros(6), "", {}
    shown, axes = [], [""] * 2
    for of, bias in found:
        hidden = learnt.hidden.get(of, {})
        seen = [a not in hidden.get(i, "") for i in BIASES for a in "xyz"]
        shown.append(np.where(seen, bias, np.nan))
    table = np.array(shown)
    there = ~np.isnan(table)
    mean = np.where(there, table, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    for k, lost in enumerate(~there.any(axis=0)):
        axes[k // 3] += "xyz"[k % 3] if lost else ""
    names = ", ".join(Path(of).name for of, _ in found if of)
    words = f"biases of {names or said or 'the result'}"
    if len(found) > 1:
        spread = np.abs(table - mean)[there].max()
        words = f"biases: mean of {names}, up to {spread:.2g} away (another day they are others)"
    return mean, words, {i: a for i, a in zip(BIASES, axes, strict=True) if a}


def _bias_sigma(document: Mapping[str, Any], recording: Recording | None) -> Array:
    """Sigmas of the biases (6,), nan where none is said; of several recordings, whose biases are
    averaged, with what they differ by."""
    days = document.get("recordings", [])
    if recording is not None:
        name = Path(recording.path).name
        days = [d for d in days if Path(d["recording"]["path"]).name == name] or days
    out = np.full(6, np.nan)
    for k, (effect, axis) in enumerate((i, a) for i in BIASES for a in "xyz"):
        own = [
            (p["value"], p["sigma"])
            for d in days or [document]
            for p in d["parameters"]
            if (p["effect"], p["name"]) == (effect, axis) and p.get("sigma")
            and p.get("observable") is not False
        ]  # fmt: skip
        if own:
            values, sigmas = np.array(own, dtype=np.float64).T
            out[k] = np.sqrt((sigmas**2).mean() + values.var())
    return out


def warnings_of(document: Mapping[str, Any]) -> list[str]:
    """What a result warns of, its doubts first, each once, on one line."""
    trust = of_document("the result", document)
    found = [*said("This result", trust)]
    found += [w for w in document.get("warnings", []) if w not in trust.reasons]
    for r in document.get("recordings", []):
        found += [w for w in r.get("warnings", []) if w not in trust.reasons]
    return list(dict.fromkeys(one_line(" ".join(str(w).split())) for w in found))


def recordings_of(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The recordings that a result is of, as its JSON has them."""
    several = [r["recording"] for r in document.get("recordings", [])]
    return [r for r in several or [document.get("recording", {})] if r.get("path")]
