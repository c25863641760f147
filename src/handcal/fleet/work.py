"""What is done with one recording, in a process of its own."""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from handcal.estimate.quadratic import Quadratic
from handcal.explain import explain
from handcal.explanation import Explanation
from handcal.fleet.laws import laws_json
from handcal.fleet.record import Document, shown
from handcal.fleet.remote import fetched
from handcal.fleet.told import Telling, told
from handcal.population.joint import Information
from handcal.recordings.inputs import load
from handcal.show.calibration.summary import stamped
from handcal.show.explanation.document import explanation_json
from handcal.types import Array, HandcalError, Prior, Recording


def explained(request: Mapping[str, Any]) -> Document:
    """The explanation of the recording at ``path``, and what it tells of every parameter.

    request: ``path`` (or address), ``budget`` (s or None) and ``prior`` (a Prior as JSON has it, or
    None). Errors: HandcalError.
    """
    with fetched(request["path"]) as (path, sha256):
        recording = load(path)
        before = prior_of(request["prior"])
        explanation = explain([recording], budget=request["budget"], before=before)
        document = stamped(explanation_json(explanation))
    if sha256 is not None:
        document["recording"] |= {"path": shown(request["path"]), "sha256": sha256}
    try:
        telling, untold = told(recording, explanation.model), ""
    except HandcalError as error:
        telling, untold = None, str(error)
    out = summary(recording, explanation, document, telling, untold)
    return out | {"explanation": document, "fetched": sha256}


def summary(
    recording: Recording, explanation: Explanation, document: Document, telling: Telling | None,
    untold: str = "",
) -> Document:  # fmt: skip
    """What is kept of a recording beside its explanation: some tens of kilobytes. untold: why it
    tells nothing of the devices of its model, where ``telling`` is None."""
    named = [
        {k: m[k] for k in ("effect", "probability", "log_evidence_gain", "indistinguishable_from",
                           "parameters")}
        for m in document["missing"]
    ]  # fmt: skip
    return {
        "recording": {k: v for k, v in document["recording"].items() if k != "streams"}
        | {"streams": sorted(document["recording"]["streams"])},
        "device": recording.device, "model": recording.model,
        "gravity": _gravity(recording),
        "verdict": explanation.verdict,
        "named": named,
        "unnamed": [u["formula"] for u in document["unnamed"]],
        "hypotheses": [{k: h[k] for k in ("effect", "alone", "probability")}
                       for h in document["hypotheses"]],
        "told": [],
        "held_out": document["held_out"],
        "warnings": document["warnings"],
        "trust": document["trust"], "trust_reasons": document["trust_reasons"],
    } | ({"untold": untold} if telling is None else _told_json(telling))  # fmt: skip


def _told_json(telling: Telling) -> Document:
    return {
        "told": [asdict(t) for t in telling.values],
        "information": information_json(telling.information),
        "laws": laws_json(telling.laws),
    }


def information_json(q: Quadratic) -> Document:
    """Names, b (k,) and the lower triangle of G (k, k), as little-endian float64 in base64."""
    lower = q.G[np.tril_indices(len(q.b))]
    return {"names": [list(n) for n in q.names], "b": _packed(q.b), "G": _packed(lower)}


def _packed(x: Array) -> str:
    return b64encode(np.ascontiguousarray(x, "<f8").tobytes()).decode()


def information_of(document: Document) -> Information:
    """The same the other way round."""
    b, lower = (np.frombuffer(b64decode(document[k]), "<f8") for k in ("b", "G"))
    G = np.zeros((len(b), len(b)))
    G[np.tril_indices(len(b))] = lower
    names = tuple((str(e), str(n)) for e, n in document["names"])
    return Information(names, b.copy(), G + np.tril(G, -1).T)


def _gravity(recording: Recording) -> float:
    """Median size of what the accelerometer reads, m/s^2: in another unit it is far from 9.8."""
    return float(np.median(np.linalg.norm(recording.imu.accel, axis=1)))


def prior_of(document: Mapping[str, Any] | None) -> Prior | None:
    """A prior as it travels: ``names``, ``mean``, ``sigma`` (SI) and ``source``."""
    if document is None:
        return None
    names = tuple((str(e), str(n)) for e, n in document["names"])
    sigma = np.array(document["sigma"], dtype=float)
    mean = np.array(document["mean"], dtype=float)
    return Prior(names, mean, np.diag(sigma**2), dict(document["source"]))


def prior_json(prior: Prior | None) -> Document | None:
    """The same the other way round, of a prior whose parameters do not depend on each other."""
    if prior is None:
        return None
    return {"names": [list(n) for n in prior.names], "mean": prior.mean.tolist(),
            "sigma": np.sqrt(np.diag(prior.covariance)).tolist(),
            "source": json.loads(json.dumps(dict(prior.source)))}  # fmt: skip
