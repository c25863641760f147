"""A device file: what earlier sessions said of one physical device, as TOML that can be read.

A session is one result of ``calibrate`` or ``explain``: date, temperature, recordings, and the
posterior of its parameters beside the prior that it was made with, so that what the session itself
said can be told from what was known before it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from handcal import output
from handcal.documents import own_toml, read_json
from handcal.effects import Effect, catalogue
from handcal.estimate.start import BIASES
from handcal.types import CALIBRATION_SCHEMA, EXPLANATION_SCHEMA, Array, InputError, Likelihood

SCHEMA = "handcal/device/1"
# (A device has a few dozen parameters and some hundred sessions at the most.)
MOST_BYTES = 50_000_000
# Of the effects that change what there is to be measured, what nevertheless stays with a device.
STAYS = ("lever_arm",)

Name = tuple[str, str]


@dataclass(frozen=True)
class Session:
    """One result. recorded: when (UTC); temperature: degC, or None; recordings, sha256: names and
    digests of the files. names (k,), mean (k,), covariance (k, k): posterior, SI; prior_mean (k,),
    prior_covariance (k, k): what it was made with; likelihood: information (k, k) and
    vector (k,) of the recording alone (``types.Likelihood``), where the result has them."""

    recorded: datetime
    temperature: float | None
    recordings: tuple[str, ...]
    sha256: tuple[str, ...]
    names: tuple[Name, ...]
    mean: Array
    covariance: Array
    prior_mean: Array
    prior_covariance: Array
    likelihood: tuple[Array, Array] | None = None


@dataclass(frozen=True)
class Device:
    """name: of the device; sessions in the order of their dates; sha256: of the file."""

    name: str
    sessions: tuple[Session, ...]
    sha256: str = ""


def persistent(effect: Effect) -> bool:
    """Whether an effect is of the device and the same another day."""
    passing = effect.of_one_day or effect.process is not None or effect.moments is not None
    acts = effect.imu_error is not None and not effect.world
    return effect.id in STAYS or (acts and not passing and not effect.baseline)


def kept(name: Name) -> bool:
    """Whether a parameter is kept over time: biases (they are forgotten) and what persists."""
    effect = catalogue().get(name[0])
    if effect is None or name[1] not in {p.name for p in effect.parameters}:
        return False
    return name in BIASES or persistent(effect)


def unit_of(name: Name) -> str:
    """SI unit of a parameter in the catalogue."""
    return next(p.unit for p in catalogue()[name[0]].parameters if p.name == name[1])


def usual_of(names: Sequence[Name]) -> Array:
    """Prior sigmas (k,) of the catalogue, SI."""
    sigmas = {(e.id, p.name): p.prior_sigma for e in catalogue().values() for p in e.parameters}
    return np.array([sigmas[n] for n in names])


def read(path: Path) -> Device:
    """The device of a file. Errors: InputError."""
    made = f"`handcal device add {path} RESULT.json`"
    document, sha256 = own_toml(path, SCHEMA, "device file", made, MOST_BYTES)
    try:
        sessions = [_session(s) for s in document.get("session", [])]
        name = str(document["name"])
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, np.linalg.LinAlgError) as error:
        raise InputError(f"{path} is damaged ({error}).") from None
    return Device(name, _ordered(sessions), sha256)


def _session(entry: Mapping[str, Any]) -> Session:
    recorded = entry["recorded"]
    if not isinstance(recorded, datetime) or recorded.tzinfo is None:
        raise ValueError("recorded: expected a date with time and zone")
    names = tuple(_name(str(n)) for n in entry["parameters"])
    usual = usual_of(names)
    mean = _numbers(entry["mean"], len(names))
    spread = entry.get("covariance")
    C = _matrix(np.diag(_numbers(entry["sigma"], len(names)) ** 2) if spread is None else spread)
    temperature = entry.get("temperature_degC")
    return Session(
        recorded.astimezone(UTC),
        None if temperature is None else float(temperature),
        tuple(str(r) for r in entry["recordings"]),
        tuple(str(d) for d in entry["sha256"]),
        names,
        mean,
        _sized(C, len(names)),
        _numbers(entry.get("prior_mean", [0.0] * len(names)), len(names)),
        _sized(_matrix(entry.get("prior_covariance", np.diag(usual**2))), len(names)),
        _told(entry, names, names) if "information" in entry else None,
    )


def _told(
    entry: Mapping[str, Any], have: Sequence[Name], wanted: Sequence[Name]
) -> tuple[Array, Array]:
    """Information and vector of the parameters wanted, where a list has them; zero elsewhere."""
    information = np.array(entry["information"], dtype=float)
    vector = _numbers(entry["vector"], len(have))
    if information.shape != (len(have), len(have)) or not np.isfinite(information).all():
        raise ValueError("an information matrix has another size than the parameters")
    there = [have.index(n) for n in wanted if n in have]
    here = [k for k, n in enumerate(wanted) if n in have]
    out, told = np.zeros((len(wanted), len(wanted))), np.zeros(len(wanted))
    out[np.ix_(here, here)] = information[np.ix_(there, there)]
    told[here] = vector[there]
    return out, told


def _name(text: str) -> Name:
    effect, _, name = text.partition(".")
    if not kept((effect, name)):
        raise ValueError(f"nothing is known of {text[:60]} here")
    return effect, name


def _numbers(values: Any, count: int) -> Array:
    out = np.array(values, dtype=float)
    if out.shape != (count,) or not np.isfinite(out).all():
        raise ValueError("a list of numbers has another length than the parameters")
    return out


def _matrix(values: Any) -> Array:
    """A covariance. Raises ValueError and LinAlgError where it is none."""
    out = np.array(values, dtype=float)
    if out.ndim != 2 or out.shape[0] != out.shape[1] or not np.isfinite(out).all():
        raise ValueError("a covariance is no square of numbers")
    if not (np.diag(out) > 0.0).all():
        raise ValueError("a variance is not positive")
    sigma = np.sqrt(np.diag(out))
    np.linalg.cholesky(out / np.outer(sigma, sigma) + 1e-6 * np.eye(len(out)))
    return np.asarray(0.5 * (out + out.T))


def _sized(matrix: Array, count: int) -> Array:
    if len(matrix) != count:
        raise ValueError("a covariance has another size than the parameters")
    return matrix


def _ordered(sessions: Sequence[Session]) -> tuple[Session, ...]:
    return tuple(sorted(sessions, key=lambda s: s.recorded))


def write(device: Device, path: Path) -> None:
    """Write a device file. Errors: HandcalError."""
    text = [
        "# What handcal knows of one device. `handcal device show` prints it, `handcal calibrate",
        "# --device` begins with it. SI units; means and covariances are those of each result,",
        "# prior_mean and prior_covariance what that result was made with, where not the usual;",
        "# information and vector what the recording itself says, without any prior.",
        f"schema = {_text(SCHEMA)}",
        f"name = {_text(device.name)}",
        *(line for s in device.sessions for line in _written(s)),
    ]
    output.write_text(path, "\n".join(text) + "\n")


def _written(s: Session) -> list[str]:
    out = ["", "[[session]]", f"recorded = {s.recorded.isoformat().replace('+00:00', 'Z')}"]
    if s.temperature is not None:
        out.append(f"temperature_degC = {float(s.temperature)!r}")
    out += [
        f"recordings = [{', '.join(map(_text, s.recordings))}]",
        f"sha256 = [{', '.join(map(_text, s.sha256))}]",
        f"parameters = [{', '.join(_text('.'.join(n)) for n in s.names)}]",
        f"mean = {_row(s.mean)}",
        f"sigma = {_row(np.sqrt(np.diag(s.covariance)))}",
        *_square("covariance", s.covariance),
    ]
    usual = np.diag(usual_of(s.names) ** 2)
    if s.prior_mean.any() or not np.array_equal(s.prior_covariance, usual):
        out += [
            f"prior_mean = {_row(s.prior_mean)}",
            *_square("prior_covariance", s.prior_covariance),
        ]
    if s.likelihood is not None:
        out += [*_square("information", s.likelihood[0]), f"vector = {_row(s.likelihood[1])}"]
    return out


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")


def _row(values: Array) -> str:
    return f"[{', '.join(repr(float(v)) for v in values)}]"


def _square(name: str, matrix: Array) -> list[str]:
    return [f"{name} = [", *(f"  {_row(r)}," for r in matrix), "]"]


def read_result(path: Path) -> Mapping[str, Any]:
    """The JSON of ``calibrate`` or ``explain``. Errors: InputError."""
    document = read_json(path)
    known = (CALIBRATION_SCHEMA, EXPLANATION_SCHEMA)
    if not isinstance(document, dict) or document.get("schema") not in known:
        raise InputError(
            f"{path} is no result of `handcal calibrate --json` or `handcal explain --json`."
        )
    return document


def session_of(
    path: Path, document: Mapping[str, Any], device: str, date: datetime | None = None,
    temperature: float | None = None,
) -> Session:  # fmt: skip
    """What a result (its file and what ``read_result`` read) says of the device of this name; date
    and temperature (degC) where it does not say them. Errors: InputError."""
    try:
        return _learnt(path, document, device, date, temperature)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, np.linalg.LinAlgError) as error:
        raise InputError(f"{path} is damaged ({str(error)[:80]}).") from None


def _learnt(
    path: Path, document: Mapping[str, Any], device: str, date: datetime | None,
    temperature: float | None,
) -> Session:  # fmt: skip
    made_with = document.get("device")
    if made_with is not None and made_with["name"] != device:
        raise InputError(
            f"{path} was made with what is known of '{made_with['name']}', and this is the file of "
            f"'{device}': two devices are not mixed."
        )
    parts = list(document.get("recordings", [])) or [document]
    about = [p["recording"] for p in parts]
    dates = [datetime.fromisoformat(str(r["recorded"])) for r in about if r.get("recorded")]
    if date is None and not dates:
        raise InputError(f"{path} does not say when it was recorded: say --date 2026-05-01.")
    degrees = [float(r["temperature_degC"]) for r in about if r.get("temperature_degC") is not None]
    names, mean, C = _posterior(document, parts[-1])
    prior_mean, K = np.zeros(len(names)), np.diag(usual_of(names) ** 2)
    made_with = made_with or document.get("priors")
    if made_with is not None:
        prior = made_with["prior"]
        of = {(str(e), str(n)): i for i, (e, n) in enumerate(prior["parameters"])}
        here = [i for i, n in enumerate(names) if n in of]
        there = [of[names[i]] for i in here]
        prior_mean[here] = _numbers(prior["mean"], len(of))[there]
        K[np.ix_(here, here)] = _sized(_matrix(prior["covariance"]), len(of))[np.ix_(there, there)]
    return Session(
        (date or max(dates)).astimezone(UTC),
        temperature if temperature is not None else float(np.mean(degrees)) if degrees else None,
        tuple(Path(str(r["path"])).name for r in about),
        tuple(str(r["sha256"]) for r in about if r.get("sha256")),
        names, mean, C, prior_mean, K, _likelihood(document, names),
    )  # fmt: skip


def _likelihood(document: Mapping[str, Any], names: Sequence[Name]) -> tuple[Array, Array] | None:
    """What a recording itself says of these parameters; None where its result does not have it."""
    said = document.get("likelihood")
    if said is None:
        return None
    have = tuple((str(effect), str(name)) for effect, name in said["parameters"])
    return told_of(Likelihood(have, *_told(said, have, have)), names)


def told_of(said: Likelihood, names: Sequence[Name]) -> tuple[Array, Array]:
    """Information (k, k) and vector (k,) of these parameters, those of the catalogue that are not
    among them integrated out at their usual sizes; zero for what the likelihood does not have."""
    have, information, vector = said.names, said.information, said.vector
    other = [k for k, n in enumerate(have) if n not in names and n[0] in catalogue()]
    mine = [k for k, n in enumerate(have) if n in names]
    usual = usual_of([have[k] for k in other])
    A = information[np.ix_(other, other)] * np.outer(usual, usual) + np.eye(len(other))
    cross = information[np.ix_(mine, other)] * usual
    solved = np.linalg.solve(A, np.column_stack([cross.T, vector[other] * usual]))
    left = information[np.ix_(mine, mine)] - cross @ solved[:, :-1]
    told = {"information": 0.5 * (left + left.T), "vector": vector[mine] - cross @ solved[:, -1]}
    return _told(told, [have[k] for k in mine], names)


def _posterior(
    document: Mapping[str, Any], last: Mapping[str, Any]
) -> tuple[tuple[Name, ...], Array, Array]:
    """Names, means and covariance of what is kept: of several recordings, with the last's biases
    (before it, each had its own)."""
    blocks = [document] if last is document else [last, document]
    names: list[Name] = []
    means: list[float] = []
    found: list[Array] = []
    for block in blocks:
        rows = block["parameters"]
        at = [
            i for i, p in enumerate(rows)
            if kept((str(p["effect"]), str(p["name"])))
            and p["value"] is not None and p["sigma"] is not None
        ]  # fmt: skip
        names += [(str(rows[i]["effect"]), str(rows[i]["name"])) for i in at]
        means += [float(rows[i]["value"]) for i in at]
        sigma = np.array([float(rows[i]["sigma"]) for i in at])
        C = np.diag(sigma**2)
        if block.get("covariance") is not None:
            C = np.array(block["covariance"], dtype=float)[np.ix_(at, at)]
        found.append(C)
    if not names:
        raise ValueError("it holds no parameter of a device")
    C = np.zeros((len(names), len(names)))
    first = 0
    for block_C in found:
        C[first : first + len(block_C), first : first + len(block_C)] = block_C
        first += len(block_C)
    return tuple(names), _numbers(means, len(names)), _matrix(C)


def added(device: Device, session: Session) -> Device:
    """The device with one more session. Raises InputError for a recording that is in it already."""
    for old in device.sessions:
        if set(old.sha256) & set(session.sha256):
            raise InputError(
                f"{', '.join(session.recordings)} is in the device file already, recorded "
                f"{old.recorded:%Y-%m-%d}: the same readings count once."
            )
    return replace(device, sessions=_ordered([*device.sessions, session]))
