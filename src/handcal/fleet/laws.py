"""What a recording tells of the laws that devices may have in common, as it is kept, and the file
of a law that was found."""

from __future__ import annotations

import math
from base64 import b64decode, b64encode
from pathlib import Path

import numpy as np

from handcal import output
from handcal.explanation import Unnamed
from handcal.fleet.record import Document
from handcal.laws import law_file
from handcal.laws.curve import drivers_of
from handcal.laws.law_effect import effect_of, named
from handcal.laws.of_devices import Known, all_laws
from handcal.population.laws import Asked, CommonLaw
from handcal.types import Array, Parameter

FOLDER = "laws"


def laws_json(known: Known) -> Document:
    """How many laws there are, and value and sigma of each (n, 2), SI, as little-endian float32 in
    base64."""
    pairs = np.stack([known.value, known.sigma], axis=1).astype("<f4")
    return {"count": len(pairs), "told": b64encode(pairs.tobytes()).decode()}


def laws_of(document: Document | None) -> tuple[Array, Array] | None:
    """Value and sigma (n,) the other way round; None of a program that asked about others."""
    if document is None or document["count"] != len(all_laws()):
        return None
    pairs = np.frombuffer(b64decode(document["told"]), "<f4").reshape(-1, 2).astype(np.float64)
    return pairs[:, 0], pairs[:, 1]


def asked() -> Asked:
    """The laws that recordings were asked about."""
    laws = all_laws()
    usual = np.array([law.sigmas[0] for law in laws])
    return Asked(usual, lambda i: laws[i].said, lambda i: named(laws[i]))


def unnamed_of(found: CommonLaw) -> Unnamed:
    """The law as an explanation has it: its constant is the mean of the devices', its sigma is of
    one more device."""
    law, p = all_laws()[found.index], found.population
    (parameter,) = law.parameters
    sigma = math.hypot(p.deviation, p.mean_sigma)
    constant = Parameter(
        law.said, parameter.name, p.mean, sigma, parameter.unit, law.sigmas[0], None
    )
    return Unnamed(
        law.said, p.mean, sigma, parameter.unit, found.stack.gain, channels=law.channels,
        drivers=drivers_of(law.said),
        constants=(constant,), made=effect_of(law).made,
    )  # fmt: skip


def write_law(found: CommonLaw, folder: Path, effect_id: str, model: str) -> Path:
    """The law as a file of the catalogue for ``--effects-from``. Errors: HandcalError."""
    folder.mkdir(exist_ok=True)
    u = unnamed_of(found)
    where = f"{found.stack.devices} devices of {model}"
    path = folder / f"{effect_id}.py"
    law = law_file.law_of(u)
    text = law_file.text_of(law, effect_id, where, u.log_evidence_gain, "handcal fleet")
    output.write_bytes(path, text.encode("utf-8", errors="backslashreplace"))
    return path
