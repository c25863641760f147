"""What `make judge` keeps of one explanation."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

from judge_cases import ROOT, Case

from handcal_sim.effects import EFFECTS
from handcal_sim.prove.further import worked_out
from handcal_sim.prove.given import Ticket
from handcal_sim.prove.score import claims, outcome
from handcal_sim.prove.suites import SUITES, Answer
from handcal_sim.prove.trial import Document, Trial, named, reported

sys.path.append(str(ROOT / "docs"))
from make_gallery import judged

Row = dict[str, Any]
# All that is kept of a recording whose licence allows no more.
FIGURES = ("name", "suite", "group", "outcome", "right", "verdict", "off", "seconds", "processor_s")
ARM = "lever_arm"


def row_of(
    case: Case, file: Path, answer: Answer | None, document: Document, seconds: float
) -> Row:
    """The row of a recording; of a real one there is no answer."""
    scored = (
        _real(case, document)
        if answer is None
        else _drawn(case, Trial(case.name, answer, document, seconds))
    )
    row = {
        "name": case.name, "suite": case.suite, "sha256": _sha256(file),
        "seconds": round(seconds, 1), "processor_s": round(document["processor_s"], 1),
        **scored, **_said(document),
    }  # fmt: skip
    return {k: row[k] for k in FIGURES} if case.known.get("figures_only") else row


def _drawn(case: Case, trial: Trial) -> Row:
    said = outcome(trial)
    right = SUITES[case.suite].right if case.suite in SUITES else ("exact", "right_set")
    further = worked_out(Ticket(case.suite, case.number, case.seed), trial.document)
    return {
        "group": trial.answer.group, "outcome": said, "right": said in right,
        "off": off_truth(trial), "claims": claims(trial),
        "further": {k: _rounded(v) for k, v in further.items()},
    }  # fmt: skip


def _real(case: Case, document: Document) -> Row:
    """Its outcome says how many of the known numbers lie within 2 and 3 sigma of their
    tolerance."""
    if "error" in document:
        return {"group": "", "outcome": "failed", "right": False, "off": {}}
    off = off_known(case.known["known"], document)
    two, three = (sum(x is not None and abs(x) <= k for x in off.values()) for k in (2, 3))
    return {
        "group": "", "outcome": f"{two} and {three} of {len(off)}" if off else "",
        "right": three == len(off) if off else None, "off": off,
    }  # fmt: skip


def off_truth(trial: Trial) -> dict[str, float]:
    """By how many sigmas each parameter differs from the truth."""
    found = {}
    for p in trial.document.get("parameters", []):
        alone = replace(trial, document={**trial.document, "parameters": [p]})
        for (value,) in reported(alone, EFFECTS).values():
            found[f"{p['effect']} {p['name']}"] = _rounded(value)
    return found


def off_known(facts: Sequence[Mapping[str, Any]], document: Document) -> dict[str, float | None]:
    """By how many sigmas each parameter lies beyond the tolerance of what is known; None where it
    should have been named. What this motion cannot tell is not asked for."""
    found: dict[str, float | None] = {}
    for fact in facts:
        for row in judged(fact, _comparable(fact, document)):
            if row["found"] is not None:
                off = row["found"] - row["known"]
                beyond = max(abs(off) - row["within"], 0.0) / row["sigma"]
                value = _rounded(beyond if off > 0.0 else -beyond) + 0.0  # (no -0.0)
            elif row["word"] == "not told":
                continue
            else:
                value = None if row["word"] == "missed" else 0.0
            found[f"{row['effect']} {row['name']}"] = value
    return found


def _comparable(fact: Mapping[str, Any], document: Document) -> dict[str, Any]:
    """The document with the values that the fact speaks of: without a common part, and with the arm
    that three accelerometers at places of their own have in common."""
    parameters = list(document["parameters"])
    names = {p["effect"] for p in parameters}
    if fact["effect"] == ARM and ARM not in names and "size_effect" in names:
        place = {p["name"]: p for p in parameters if p["effect"] == "size_effect"}
        for axis in "xyz":
            rows = [place[row + axis] for row in "xyz"]
            value, sigma = fmean(p["value"] for p in rows), max(p["sigma"] for p in rows)
            parameters.append({"effect": ARM, "name": axis, "value": value, "sigma": sigma})
    own = [p for p in parameters if p["effect"] == fact["effect"]]
    if fact.get("common") and own:
        more = fmean(fact["values"]) - fmean(p["value"] for p in own)
        parameters = [{**p, "value": p["value"] + more} if p in own else p for p in parameters]
    return {"untellable": [], **document, "parameters": parameters}


def _said(document: Document) -> Row:
    if "error" in document:
        return {"verdict": "failed", "error": document["error"]}
    fit, held = document["fit"], document["held_out"]
    return {
        "verdict": document["verdict"],
        "named": named(document),
        "unnamed": [{k: u[k] for k in ("channels", "drivers")} for u in document["unnamed"]],
        "log_evidence": round(fit["after"]["log_evidence"], 2),
        "log_evidence_before": round(fit["before"]["log_evidence"], 2),
        "held_out": held and [round(held[f"log_score_{k}"], 2) for k in ("before", "after")],
    }


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _sha256(file: Path) -> str:
    """Of the file; of a folder, of all files in it. A few digits tell recordings apart."""
    parts = sorted(file.rglob("*")) if file.is_dir() else [file]
    return hashlib.sha256(b"".join(part.read_bytes() for part in parts)).hexdigest()[:16]
