"""Results as JSON, and the figures that terminal, report and dashboard share."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import handcal
from handcal import output
from handcal.device.another import read_noise, rest_noise
from handcal.estimate.parameters import given_model, with_shown
from handcal.show import doubts, words
from handcal.show.calibration.how_good import quality_json
from handcal.trust import json_of, together
from handcal.types import (
    CALIBRATION_SCHEMA,
    Array,
    Innovations,
    Likelihood,
    MarkerRotation,
    Parameter,
    Prior,
    Recording,
    Result,
)

if TYPE_CHECKING:
    from handcal import results

# Where the contract's name differs from that of the noise level.
NOISE_NAMES = {"sway": "hand_sway"}
# Parameters that every recording has of its own.
OWN = ("gyro_bias", "accel_bias")
# What several results of one fit say once, or not at all.
_OF_ALL = ("model", "device", "priors", "likelihood", "trust", "trust_reasons")


def finite(value: float | None) -> float | None:
    """The number as JSON can hold it: None for what is not finite."""
    return float(value) if value is not None and math.isfinite(value) else None


def whiteness(innovations: Innovations) -> float | None:
    """Lag-one autocorrelation of the standardised innovations, averaged over the channels.

    0 for a filter that leaves nothing behind; None with fewer than three updates.
    """
    if innovations.t.size < 3:
        return None
    z = innovations.residual / innovations.sigma
    power = (z * z).mean(0)
    return finite(float(np.mean((z[1:] * z[:-1]).mean(0) / np.where(power > 0, power, 1.0))))


def nis_band(dof: int) -> tuple[float, float]:
    """2.5 % and 97.5 % points of chi-square per degree of freedom, for ``dof`` of them."""
    from scipy.special import gammaincinv

    low, high = (2.0 * float(gammaincinv(dof / 2, p)) / dof for p in (0.025, 0.975))
    return low, high


def windowed_nis(innovations: Innovations, window: int) -> tuple[Array, Array]:
    """Running mean of NIS per degree of freedom over ``window`` updates.

    Returns t (k - window + 1,) s, the last of each window, and the mean; with fewer
    updates than ``window``, one mean over them all.
    """
    k, d = innovations.residual.shape
    n = min(window, k)
    total = np.concatenate([[0.0], np.cumsum(innovations.nis)])
    return innovations.t[n - 1 :], (total[n:] - total[:-n]) / (n * d)


def settled(residual: Array, sigma: Array) -> float:
    """Half the height of a plot that shows residuals and 3 sigma, but for the first few."""
    if residual.size == 0:
        return 1.0
    widest = max(np.quantile(3 * sigma, 0.9), np.quantile(np.abs(residual), 0.99))
    return 1.25 * float(widest) or 1.0


def gapped(t: Array, degrees: Array) -> tuple[Array, Array]:
    """A curve of angles, t (k,) and degrees (k,), with a NaN where it jumps past +-180."""
    cuts = np.flatnonzero(np.abs(np.diff(degrees)) > 180.0) + 1
    return np.insert(t, cuts, 0.5 * (t[cuts - 1] + t[cuts])), np.insert(degrees, cuts, np.nan)


def parameters_json(
    parameters: Sequence[Parameter], covariance: Array | None, found: Collection[str]
) -> list[results.parts.Parameter]:
    """The contract's ``parameters``; found: effects that ``given_model`` has."""
    if covariance is None or len(covariance) != len(parameters):
        return [parameter_json(p) for p in parameters]
    alone = given_model(parameters, covariance, found)
    return [
        parameter_json(p) | {"given_model": {"value": finite(v), "sigma": finite(s)}}
        for p, v, s in zip(parameters, *alone, strict=True)
    ]


def parameter_json(p: Parameter) -> results.parts.Parameter:
    """One entry of ``parameters``, as the contract has it."""
    return {
        "effect": p.effect,
        "name": p.name,
        "value": finite(p.value),
        "sigma": finite(p.sigma),
        "unit": p.unit,
        "shown": bool(p.shown),
        "observable": bool(p.shown),
        "converged_at_s": finite(p.converged_at_s),
    }


def untellable_json(parameters: Sequence[Parameter]) -> list[results.parts.Untellable]:
    """The contract's ``untellable``: what the recording cannot show."""
    return [
        {"effect": p.effect, "name": p.name, "sigma": finite(p.sigma), "unit": p.unit}
        for p in parameters
    ]


def recording_json(recording: Recording, assume: str) -> dict[str, Any]:
    """The contract's ``recording``."""
    streams = {"imu": recording.imu.t} | {n: s.t for n, s in recording.streams.items()}
    return {
        "path": recording.path,
        "duration_s": finite(recording.duration_s),
        "imu_rate_hz": finite(recording.rate_hz),
        "streams": {
            name: {"samples": int(t.size)}
            | ({"topic": recording.topics[name]} if name in recording.topics else {})
            for name, t in streams.items()
        },
        "assume": assume,
        "sha256": digest(Path(recording.path)),
        **{k: v for k in ("device", "model") if (v := getattr(recording, k))},
        **_noise_read(recording),
        **_day(recording),
        **({"vehicle": dict(recording.vehicle)} if recording.vehicle else {}),
        **({"corrected": dict(recording.corrected)} if recording.corrected else {}),
    }


def _noise_read(recording: Recording) -> dict[str, Any]:
    """White noise of the readings, moving and at rest, where there are enough of them."""
    noise = read_noise(recording)
    return {"read_noise": noise, "rest_noise": rest_noise(recording)} if noise else {}


def _day(recording: Recording) -> dict[str, Any]:
    """When it was recorded, and how warm it was, where the recording says so."""
    out: dict[str, Any] = {}
    if recording.start_ns:
        begun = datetime.fromtimestamp(recording.start_ns // 10**9, UTC)
        out["recorded"] = begun.isoformat().replace("+00:00", "Z")
    if (degrees := mean_temperature(recording)) is not None:
        out["temperature_degC"] = degrees
    return out


def mean_temperature(recording: Recording) -> float | None:
    """degC, None where the recording has none."""
    series = recording.streams.get("temperature")
    return None if series is None or not len(series.t) else finite(float(series.value.mean()))


def digest(path: Path) -> str | None:
    """Of a recording's file; None where it is a folder, or was never a file."""
    if not path.is_file():
        return None
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def calibration_json(result: Result | Sequence[Result]) -> dict[str, Any]:
    """The contract's ``calibrate --json``.

    ``whiteness`` is the function of that name, for each kind of observation. For several
    results of one fit, ``parameters`` holds the shared ones and ``recordings`` the rest.
    """
    if not isinstance(result, Result):
        return calibration_json(result[0]) if len(result) == 1 else _together_json(result)
    kinds, trust = result.innovations, doubts.of_calibration(result)
    return {
        "schema": CALIBRATION_SCHEMA,
        **json_of(trust),
        "recording": recording_json(result.recording, result.assume),
        "parameters": parameters_json(
            result.parameters, result.covariance, with_shown(result.parameters)
        ),
        "noise": [
            {"name": NOISE_NAMES.get(n.name, n.name), "value": finite(n.value), "unit": n.unit}
            for n in result.noise
        ],
        "fit": {
            "log_evidence": finite(result.log_evidence),
            "observations": result.observations,
            "nis": {words.kind_name(kind): finite(i.mean_nis) for kind, i in kinds.items()},
            "whiteness": {words.kind_name(kind): whiteness(i) for kind, i in kinds.items()},
        },
        "untellable": untellable_json([p for p in result.parameters if not p.shown]),
        "covariance": matrix_json(result.covariance),
        **likelihood_json(result.likelihood),
        "model": dict(result.model),
        "warnings": list(dict.fromkeys((*all_warnings(result), *trust.reasons))),
        **quality_json(result.parameters, result.covariance, result.before),
        **device_json(result.before),
        **marker_json(result.marker),
    }


def matrix_json(matrix: Array) -> list[list[float | None]]:
    """Rows of a matrix."""
    return [[finite(v) for v in row] for row in matrix]


def covariance_json(
    covariance: Array, of: Sequence[Parameter], wanted: Sequence[Parameter]
) -> dict[str, Any]:
    """``covariance`` of the parameters wanted, from that of others; nothing where one lacks."""
    at = {(p.effect, p.name): i for i, p in enumerate(of)}
    rows = [at.get((p.effect, p.name), -1) for p in wanted]
    return {} if -1 in rows else {"covariance": matrix_json(covariance[np.ix_(rows, rows)])}


def likelihood_json(likelihood: Likelihood | None) -> dict[str, Any]:
    """``likelihood``: what the recording itself says, without any prior; nothing where that is not
    known."""
    if likelihood is None or not np.isfinite(likelihood.information).all():
        return {}
    return {
        "likelihood": {
            "parameters": [list(n) for n in likelihood.names],
            "information": matrix_json(likelihood.information),
            "vector": likelihood.vector.tolist(),
        }
    }


def marker_json(marker: MarkerRotation | None) -> dict[str, Any]:
    """``marker_rotation``, or nothing without a pose."""
    if marker is None:
        return {}
    turned = {"quaternion": marker.quaternion.tolist(), "sigma": marker.sigma.tolist()}
    return {"marker_rotation": turned}


def device_json(before: Prior | None) -> dict[str, Any]:
    """``device``: which file said what is known of the device before, and what; or ``priors``,
    where it is known of its model; or nothing."""
    if before is None:
        return {}
    known = {
        "parameters": [list(n) for n in before.names],
        "mean": before.mean.tolist(),
        "covariance": before.covariance.tolist(),
    }
    if "priors" in before.source:
        named = {"path" if k == "priors" else k: v for k, v in before.source.items()}
        return {"priors": {**named, "prior": known}}
    return {"device": {**before.source, "prior": known}}


def _together_json(results: Sequence[Result]) -> dict[str, Any]:
    """Several results of one fit."""
    each = [calibration_json(r) for r in results]
    shared = [p for p in results[0].parameters if p.effect not in OWN]
    apart = [i for i, p in enumerate(results[0].parameters) if p.effect in OWN]
    joint = [i for i in range(len(results[0].parameters)) if i not in apart]
    own = [
        one | {"parameters": [p for p in one["parameters"] if p["effect"] in OWN],
               "untellable": [p for p in one["untellable"] if p["effect"] in OWN],
               "covariance": matrix_json(r.covariance[np.ix_(apart, apart)])}
        for one, r in zip(each, results, strict=True)
    ]  # fmt: skip
    return {
        "schema": CALIBRATION_SCHEMA,
        **json_of(together(map(doubts.of_calibration, results))),
        "parameters": parameters_json(
            shared, results[0].covariance[np.ix_(joint, joint)], with_shown(shared)
        ),
        "noise": [],
        "fit": {"log_evidence": finite(results[0].log_evidence),
                "observations": sum(r.observations for r in results)},
        "untellable": untellable_json([p for p in shared if not p.shown]),
        "covariance": matrix_json(results[0].covariance[np.ix_(joint, joint)]),
        "model": dict(results[0].model),
        "recordings": [
            {k: v for k, v in one.items() if k not in _OF_ALL} for one in own
        ],
        "warnings": [],
        **device_json(results[0].before),
    }  # fmt: skip


def stamped(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document with the version of the program that made it."""
    return {"schema": document["schema"], "version": handcal.__version__} | dict(document)


def write_json(document: Mapping[str, Any], path: str | Path) -> None:
    """Write a JSON document, ``-`` meaning standard output, with the program's version in it. NaN
    is an error, not a token."""
    text = json.dumps(stamped(document), indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    if str(path) == "-":
        print(text, end="")
    else:
        output.write_text(path, text)


def all_warnings(result: Result) -> tuple[str, ...]:
    """What the reader repaired and what the filter remarked, each once."""
    return tuple(dict.fromkeys((*result.recording.warnings, *result.warnings, *result.doubts)))
