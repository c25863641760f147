"""A model read again from the JSON that ``explain`` and ``calibrate`` write."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from handcal.documents import read_json
from handcal.effects import Effect, catalogue, with_laws
from handcal.estimate.case import HELD, Edit, frozen_at, name_of
from handcal.estimate.parameters import Moment
from handcal.estimate.specification import BASELINE, ONLINE, Options, Specification, View
from handcal.laws import law_effect, shapes, terms, with_motion
from handcal.laws.curve import drivers_of
from handcal.observations import catalogue as observations
from handcal.types import InputError


def read(path: Path) -> Specification:
    """The model in a result. Errors: InputError."""
    return of_document(str(path), read_json(path))


def of_document(name: str, document: Any) -> Specification:
    """The same of what was read already; name: of it, in messages."""
    model = document.get("model") if isinstance(document, dict) else None
    if not isinstance(model, dict):
        raise InputError(
            f"{name} holds no model; `handcal explain --json` and `handcal calibrate --json` "
            "write one."
        )
    with _in_words(name):
        return chosen_from(model)


@contextmanager
def laws_of(name: str, document: Any) -> Iterator[None]:
    """Inside, the catalogue has the laws without a name of a result's model, so that they are taken
    off and exported like effects. name: of the result. Errors: InputError."""
    model = document.get("model") if isinstance(document, dict) else None
    with _in_words(name):
        entries = model["effects"] if model else ()
        laws = [_effect(entry) for entry in entries if "+=" in str(entry["id"])]
    with with_laws(laws):
        yield


@contextmanager
def _in_words(name: str) -> Iterator[None]:
    """What is wrong with a model, in a sentence. Errors: InputError."""
    try:
        yield
    except InputError as error:
        raise InputError(f"The model in {name}: {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(f"The model in {name} is damaged or unknown here ({error}).") from None


def chosen_from(model: Mapping[str, Any]) -> Specification:
    """The model as ``estimate.specification.document_of`` wrote it. Raises KeyError and the like
    where it is not one, InputError where it has an effect that is not in the catalogue."""
    effects, starts, moments = [], {}, {}
    for entry in model["effects"]:
        effect = _effect(entry)
        effects.append(effect)
        for name, value in entry.get("start", {}).items():
            starts[effect.id, str(name)] = float(value)
        if "moment" in entry:
            moments[effect.id] = Moment(
                float(entry["moment"]["at"]), float(entry["moment"]["sigma"])
            )
    effects += [_noise(str(i)) for i in model["noise_effects"]]
    o = model["options"]
    latitude = o.get("latitude")
    options = Options(
        None if latitude is None else float(latitude),
        float(o["height"]),
        {str(k): float(v) for k, v in o["noise"].items()},
        tuple(str(s) for s in o["ignore"]),
        bool(o["reference_exact"]),
    )
    views = tuple(_view(v) for v in model["recordings"])
    levels = tuple({str(k): float(v) for k, v in part.items()} for part in model["levels"])
    begin = str(model.get("begin", ""))
    if begin not in ("", BASELINE, ONLINE):
        raise ValueError(f"begin: {begin}")
    return Specification(tuple(effects), views, options, starts, moments, levels, begin)


def _effect(entry: Mapping[str, Any]) -> Effect:
    name = str(entry["id"])
    if "made" in entry:
        kind, numbers = str(entry["made"]["kind"]), [float(n) for n in entry["made"]["numbers"]]
        if kind == HELD:
            effect = frozen_at(_known(name_of(name)), np.array(numbers))
        elif kind.startswith(terms.CURVE):
            effect = terms.curve(kind.removeprefix(terms.CURVE), *numbers)
        elif law_effect.is_law(kind):
            effect = law_effect.effect_of(law_effect.again(kind, tuple(numbers)))
        else:
            effect = shapes.again(name.split(" += ")[0], (kind, tuple(numbers)))
    elif "+=" in name:
        effect = terms.again(name, float(entry["prior"]))
    else:
        effect = _known(name)
    # (what goes with time is of the recording in which it was found)
    one_day = effect.of_one_day or ("+=" in name and "t" in drivers_of(name))
    return replace(effect, id=name, last=bool(entry.get("last", True)), of_one_day=one_day)


def _noise(name: str) -> Effect:
    return with_motion.again(name) if with_motion.is_with_motion(name) else _known(name)


def _known(name: str) -> Effect:
    if name not in catalogue():
        raise InputError(
            f"nothing is known of its effect '{name}'; if that is a file of your own, say "
            "--effects-from with its folder."
        )
    return catalogue()[name]


def _view(entry: Mapping[str, Any]) -> View:
    kinds = tuple(str(k) for k in entry["observations"])
    for kind in kinds:
        observations()[kind]
    edits = tuple(_edit(e) for e in entry["left_out"])
    return View(
        kinds,
        str(entry["assume"]),
        entry["hand"] == "creeping",
        edits,
        tuple(str(w) for w in entry["warnings"]),
        int(entry["samples"]),
    )


def _edit(entry: Mapping[str, Any]) -> Edit:
    shifted = None
    if "shifted" in entry:
        first, last, by = (float(x) for x in entry["shifted"])
        shifted = first, last, by
    rows = tuple(int(r) for r in entry["rows"])
    return Edit(str(entry["observation"]), rows, shifted, float(entry["log_evidence"]))
