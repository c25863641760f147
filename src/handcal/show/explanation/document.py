"""An explanation as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from handcal.effects import catalogue
from handcal.estimate.specification import document_of
from handcal.explanation import (
    Explained,
    Explanation,
    Fit,
    HeldOut,
    Hypothesis,
    Mismatch,
    Missing,
    Unnamed,
    broken_off,
)
from handcal.show import doubts, words
from handcal.show.calibration import summary
from handcal.show.calibration.how_good import quality_json
from handcal.show.explanation.words import weighed
from handcal.trust import json_of
from handcal.types import EXPLANATION_SCHEMA, NoiseLevel, Parameter

if TYPE_CHECKING:
    from handcal import results


def explanation_json(explanation: Explanation) -> dict[str, Any]:
    """The contract's ``explain --json``.

    With several recordings, ``parameters`` holds the shared ones, ``recordings`` the rest,
    and each mismatch says which ``recording`` it is of. ``hypotheses`` is more than promised:
    nats of each effect ``alone`` over the baseline, in the ``final`` model, and ``expected_gain``
    of one of the usual size.
    """
    e, several = explanation, len(explanation.recordings) > 1
    trust = doubts.of_explanation(e)
    document: dict[str, Any] = {
        "schema": EXPLANATION_SCHEMA,
        "verdict": e.verdict,
        **json_of(trust),
        "mismatch": [_mismatch_json(m, several) for m in e.mismatch],
        "missing": [_missing_json(m) for m in e.missing],
        "hand": {"id": e.hand.id, "probability": summary.finite(e.hand.probability)},
        "unnamed": [_unnamed_json(u) for u in e.unnamed],
        "hypotheses": [_hypothesis_json(h, weighed(h, e)) for h in e.hypotheses],
        "fit": {"before": _fit_json(e.before), "after": _fit_json(e.after)},
        "held_out": _held_out_json(e.held_out),
        "next_motion": [
            {"motion": n.motion, "separates": list(n.separates),
             "expected_gain": summary.finite(n.expected_gain)}
            for n in e.next_motion
        ],
        "parameters": _parameters_json(e),
        "noise": _noise_json(e.noise),
        "untellable": summary.untellable_json(e.untellable),
        "model": {} if e.model is None else document_of(e.model),
        "warnings": list(dict.fromkeys((*all_warnings(e), *trust.reasons))),
    }  # fmt: skip
    if e.covariance is not None:
        document |= summary.covariance_json(e.covariance, e.parameters, final_parameters(e))
    document |= quality_json(e.parameters, e.covariance, e.device)
    document |= summary.likelihood_json(e.likelihood) | summary.device_json(e.device)
    if e.untried:
        document["untried"] = list(e.untried)
    if several:
        document["recordings"] = [_recording_json(r) for r in e.recordings]
    elif e.recordings:
        only = e.recordings[0]
        document["recording"] = summary.recording_json(only.as_read, only.assume)
        document |= summary.marker_json(only.marker)
    return document


def _parameters_json(e: Explanation) -> list[results.parts.Parameter]:
    """Of the final model, each also as it is with the effects alone that were found."""
    parameters, covariance = final_parameters(e), e.covariance
    if list(e.parameters) != parameters:
        covariance = None
    there = {p.effect for p in parameters}
    found = {i for i in there if i not in catalogue() or not catalogue()[i].common}
    for m in e.missing:
        found |= {next((i for i in (m.effect, *m.indistinguishable_from) if i in there), "")}
    return summary.parameters_json(parameters, covariance, found)


def _mismatch_json(m: Mismatch, several: bool) -> dict[str, Any]:
    out = {
        "channel": m.channel, "from_s": summary.finite(m.from_s), "to_s": summary.finite(m.to_s),
        "share": summary.finite(m.share), "when": m.when,
    }  # fmt: skip
    return out | ({"recording": m.recording} if several else {})


def _hypothesis_json(h: Hypothesis, known: bool) -> results.explain.Hypothesis:
    """known: whether its probability is."""
    return {
        "effect": h.effect, "alone": summary.finite(h.alone), "final": summary.finite(h.final),
        "expected_gain": summary.finite(h.expected),
        "probability": summary.finite(h.probability) if known else None,
    }  # fmt: skip


def final_parameters(explanation: Explanation) -> list[Parameter]:
    """Of the final model, those of the recording itself among them if there is only one."""
    found = {(p.effect, p.name): p for p in explanation.parameters}
    if len(explanation.recordings) == 1:
        for p in explanation.recordings[0].parameters:
            found.setdefault((p.effect, p.name), p)
    return list(found.values())


def all_warnings(explanation: Explanation) -> list[str]:
    """What the readers repaired and what the explanation remarks, each once."""
    read = [w for r in explanation.recordings for w in r.recording.warnings]
    cut = broken_off(explanation.untried)
    said = (*read, *explanation.warnings, *explanation.doubts, *([cut] if cut else []))
    return list(dict.fromkeys(said))


def _numbers(values: Mapping[str, float]) -> dict[str, float]:
    """The finite ones."""
    return {k: float(v) for k, v in values.items() if math.isfinite(v)}


def _kinds(values: Mapping[str, float]) -> dict[str, float]:
    return {words.kind_name(k): v for k, v in _numbers(values).items()}


def _missing_json(m: Missing) -> results.explain.Missing:
    return {
        "effect": m.effect,
        "probability": summary.finite(m.probability),
        "log_evidence_gain": summary.finite(m.log_evidence_gain),
        "indistinguishable_from": list(m.indistinguishable_from),
        "parameters": [
            {"name": p.name, "value": summary.finite(p.value), "sigma": summary.finite(p.sigma),
             "unit": p.unit}
            for p in m.parameters
        ],
        "story": m.story,
        "size": _numbers(m.size),
        "share": summary.finite(m.share),
        "held_out_gain": None if m.held_out_gain is None else summary.finite(m.held_out_gain),
    }  # fmt: skip


def _unnamed_json(u: Unnamed) -> results.explain.Unnamed:
    c = u.curve
    return {
        "formula": u.formula,
        "value": summary.finite(u.value),
        "sigma": summary.finite(u.sigma),
        "unit": u.unit,
        "log_evidence_gain": summary.finite(u.log_evidence_gain),
        "story": u.story,
        "channels": list(u.channels),
        "drivers": list(u.drivers),
        "constants": [
            {"name": p.name, "value": summary.finite(p.value), "sigma": summary.finite(p.sigma),
             "unit": p.unit}
            for p in u.constants
        ],
        "curve": {} if c is None else {
            "x": c.x.tolist(), "y": c.y.tolist(), "sigma": c.sigma.tolist(),
            "x_unit": c.x_unit, "y_unit": c.y_unit,
        },
    }  # fmt: skip


def _fit_json(fit: Fit) -> results.explain.ExplanationFit:
    return {
        "log_evidence": summary.finite(fit.log_evidence),
        "residual_rms": _numbers(fit.residual_rms),
        "nis": _kinds(fit.nis),
        "whiteness": _kinds(fit.whiteness),
    }


def _held_out_json(h: HeldOut | None) -> results.explain.HeldOut | results.kinds.Empty:
    """Empty where nothing was held out."""
    if h is None:
        return {}
    return {
        "log_score_before": summary.finite(h.log_score_before),
        "log_score_after": summary.finite(h.log_score_after),
        "residual_rms_before": _numbers(h.residual_rms_before),
        "residual_rms_after": _numbers(h.residual_rms_after),
    }


def _noise_json(noise: Sequence[NoiseLevel]) -> list[results.parts.Level]:
    return [
        {"name": summary.NOISE_NAMES.get(n.name, n.name), "value": summary.finite(n.value),
         "unit": n.unit}
        for n in noise
    ]  # fmt: skip


def _recording_json(r: Explained) -> dict[str, Any]:
    return {
        "recording": summary.recording_json(r.as_read, r.assume),
        "parameters": [summary.parameter_json(p) for p in r.parameters],
        "noise": _noise_json(r.noise),
        **summary.marker_json(r.marker),
    }
