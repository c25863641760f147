"""``handcal.open_result``: what ``calibrate`` or ``explain`` wrote as JSON, opened again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from handcal.api import tables
from handcal.api.results import Parameters
from handcal.documents import read_json
from handcal.effects import catalogue
from handcal.explanation import Missing
from handcal.types import CALIBRATION_SCHEMA, EXPLANATION_SCHEMA, Array, InputError, Parameter

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KINDS = {CALIBRATION_SCHEMA: "calibration", EXPLANATION_SCHEMA: "explanation"}


class Saved:
    """A result as its file has it, SI: ``parameters``, their ``covariance`` (or None),
    ``warnings``, ``trust`` with its reasons; of an explanation ``verdict``, ``missing`` and
    ``unnamed`` (formulas) too. ``document`` is the whole JSON. ``apply`` and ``export`` take it as
    they take a result."""

    def __init__(self, path: Path, document: Mapping[str, Any]) -> None:
        self.path, self.document = path, document
        self.kind = _KINDS[document["schema"]]
        self.parameters = Parameters(map(_parameter, _rows(document)))
        square = document.get("covariance")
        self.covariance: Array | None = None if square is None else np.array(square, dtype=float)
        self.verdict = str(document.get("verdict", ""))
        self.missing = tuple(map(_missing, document.get("missing", [])))
        self.unnamed = tuple(str(u["formula"]) for u in document.get("unnamed", []))
        self.warnings = tuple(map(str, document.get("warnings", [])))
        self.trust = str(document.get("trust", ""))
        self.trust_reasons = tuple(map(str, document.get("trust_reasons", [])))

    def plot(self) -> Figure:
        """What was found, or else what is shown, with one and three sigma, each in what is usual
        for such a device."""
        from handcal.show.calibration.plots import sizes
        from handcal.show.calibration.shown import drawn

        found = [p for m in self.missing for p in m.parameters]
        return sizes(found or drawn(self.parameters))

    def _head(self) -> str:
        trust = f", trust {self.trust}" if self.trust else ""
        verdict = f": {self.verdict}" if self.verdict else ""
        found = ", ".join([*(m.effect for m in self.missing), *self.unnamed])
        return f"Saved {self.kind} {self.path.name}{verdict}{trust}{f'; {found}' if found else ''}"

    def __repr__(self) -> str:
        return "\n".join([self._head(), repr(self.parameters), *self.trust_reasons])

    def _repr_html_(self) -> str:
        said = tables.paragraphs([self._head(), *self.trust_reasons])
        return said + self.parameters._repr_html_()


def opened(path: Path) -> Saved:
    """The result in a file. Errors: InputError."""
    document = read_json(path)
    if not isinstance(document, dict) or document.get("schema") not in _KINDS:
        raise InputError(
            f"{path} is no calibration or explanation; save(path) writes one, and so does the "
            "option --json of `handcal calibrate` and `handcal explain`."
        )
    try:
        return Saved(path, document)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path} is damaged ({str(error)[:80]}).") from None


def _rows(document: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """Of the device, and of the recording where there is but one."""
    several = document.get("recordings", [])
    return [*document["parameters"], *(several[0]["parameters"] if len(several) == 1 else [])]


def _parameter(row: Mapping[str, Any]) -> Parameter:
    effect, name = str(row["effect"]), str(row["name"])
    known = catalogue().get(effect)
    usual = [p.prior_sigma for p in known.parameters if p.name == name] if known else []
    at = row.get("converged_at_s")
    return Parameter(
        effect, name, _number(row["value"]), _number(row["sigma"]), str(row["unit"]),
        usual[0] if usual else math.nan, None if at is None else float(at),
    )  # fmt: skip


def _missing(row: Mapping[str, Any]) -> Missing:
    effect = catalogue().get(str(row["effect"]))
    gain = row.get("held_out_gain")
    return Missing(
        str(row["effect"]), effect.title if effect else str(row["effect"]),
        _number(row["probability"]), _number(row["log_evidence_gain"]),
        tuple(map(str, row["indistinguishable_from"])),
        Parameters(_parameter({"effect": row["effect"]} | p) for p in row["parameters"]),
        str(row["story"]), effect.motion if effect else "",
        {str(k): float(v) for k, v in row["size"].items()}, _number(row["share"]),
        None if gain is None else float(gain),
    )  # fmt: skip


def _number(value: Any) -> float:
    """null stands for what is not finite."""
    return math.nan if value is None else float(value)
