"""A model as it can be written down, and its one fit, which does not depend on the way there.

``explain`` ends in it and ``calibrate`` is it: the baseline first, then the chosen effects from
where the model says that they start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from handcal.effects import Effect
from handcal.estimate.baseline import started
from handcal.estimate.case import Case, Edit, case_of, creeping, edited
from handcal.estimate.fit import TOLERANCE, fitted, known_before, with_usual_noise
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Fitted, Model
from handcal.estimate.parameters import Moment
from handcal.estimate.transfer import at_constants, begun
from handcal.types import HandcalError, Prior, Recording


@dataclass(frozen=True)
class View:
    """How one recording is looked at: kinds of observation, what is assumed of the hand, whether
    its held point creeps, readings that are merely wrong, what to say about it, and the number of
    the IMU's samples, by which it is known again."""

    kinds: tuple[str, ...]
    assume: str
    creeps: bool = False
    edits: tuple[Edit, ...] = ()
    warnings: tuple[str, ...] = ()
    samples: int = 0


@dataclass(frozen=True)
class Options:
    """What the user said: latitude rad, height m, noise levels that are known (SI), streams to
    leave out, whether a reference has no bias; and what is known of the device before."""

    latitude: float | None = None
    height: float = 0.0
    fixed: Mapping[str, float] = field(default_factory=dict)
    ignore: tuple[str, ...] = ()
    reference_exact: bool = False
    before: Prior | None = None


@dataclass(frozen=True)
class Specification:
    """A model: effects (noise among them), values (SI) from which their constants start where that
    is not zero, moments of those that are held at one, and a view of each recording; levels: noise
    levels (SI) to start from instead of the usual ones, of each recording; begin: the trajectory to
    start from, BASELINE's or ONLINE, where it is known which is the better ("": both)."""

    effects: tuple[Effect, ...]
    views: tuple[View, ...]
    options: Options = Options()
    starts: Mapping[tuple[str, str], float] = field(default_factory=dict)
    moments: Mapping[str, Moment] = field(default_factory=dict)
    levels: tuple[Mapping[str, float], ...] = ()
    begin: str = ""


BASELINE, ONLINE = "baseline", "online"


def chosen_of(
    model: Model, options: Options, moments: Mapping[str, Moment], exact: bool = False
) -> Specification:
    """A model that was fitted, written down. Effects start where their size is of the order of
    their prior or more, in whole priors: what is small starts at zero, and the fit does not
    depend on the way there. exact: they start where they are, and so do the noise levels."""
    starts = {}
    for e in model.effects:
        for p in e.parameters if e.process is None else ():
            at = next(i for i, n in enumerate(model.quadratic.names) if n == (e.id, p.name))
            size = float(model.u[at]) if exact else float(np.round(model.u[at]))
            if size != 0.0:
                starts[e.id, p.name] = size * p.prior_sigma
    views = tuple(view_of(f.case) for f in model.parts)
    levels = tuple(dict(f.levels) for f in model.parts) if exact else ()
    return Specification(model.effects, views, options, starts, moments, levels)


def view_of(case: Case) -> View:
    """How a case looks at its recording."""
    read = case.read or case.recording
    said = case.warnings[len(read.warnings) :]
    return View(case.kinds, case.assume, case.creeping, case.edits, said, len(read.imu.t))


def seen(recording: Recording, view: View, options: Options) -> Case:
    """The recording as the view has it."""
    case = case_of(
        recording, view.assume, options.latitude, options.height, options.ignore, options.fixed,
        kinds=view.kinds, reference_exact=options.reference_exact, before=options.before,
    )  # fmt: skip
    case = replace(case, assume=view.assume, warnings=(*case.warnings, *view.warnings))
    case = creeping(case) if view.creeps else case
    for edit in view.edits:
        case = edited(case, edit)
    return case


def settled(base: Model, chosen: Specification, engine: str = "compiled") -> Model:
    """The fit of the chosen effects, from the baseline of the same cases.

    What the baseline lacks, its trajectory and noise levels hold. So the fit is begun more than
    once, from the baseline with the noise that is usual and from the online filter with the
    effects in it, and the best counts (of an explanation that of these is written down which was
    the better); from the baseline as it is where neither does better than no effect at all.
    """
    before = known_before(chosen.effects, chosen.options.before)
    if before is None and {e.id for e in chosen.effects} <= set(base.ids):
        return base
    at = _starts(chosen, base)
    parts = [at_constants(begun(f, chosen.effects), chosen.effects, at) for f in base.parts]
    fit = partial(fitted, effects=chosen.effects, noise_rounds=2, known=before, tolerance=TOLERANCE)
    if chosen.levels:
        noisy = [
            replace(f, levels={k: levels.get(k, v) for k, v in f.levels.items()})
            for f, levels in zip(parts, chosen.levels, strict=True)
        ]
        return fit(noisy)
    ways: list[Callable[[], Model | None]] = []
    if chosen.begin != ONLINE:
        ways.append(partial(fit, [with_usual_noise(f) for f in parts]))
    if chosen.begin != BASELINE:
        ways.append(partial(_online, base, chosen.effects, engine, fit))
    found = [m for m in in_parallel(ways) if m is not None]
    if not found or (not chosen.begin and max(m.log_evidence for m in found) < base.log_evidence):
        found.append(fit(parts))
    return max(found, key=lambda m: (m.one_sided, m.log_evidence))


def _online(
    base: Model, effects: Sequence[Effect], engine: str, fit: Callable[[Sequence[Fitted]], Model]
) -> Model | None:
    """The fit from the online filter with the effects in it; None where they lead that astray."""
    try:
        return fit([started(f.case, effects, engine) for f in base.parts])
    except HandcalError:
        return None


def _starts(chosen: Specification, base: Model) -> dict[tuple[str, str], float]:
    """Values (SI) from which constants start that are not zero: as the model says, else as they
    are known to be."""
    of_device = chosen.options.before
    known = {} if of_device is None else dict(zip(of_device.names, of_device.mean, strict=True))
    mine = {(e.id, p.name) for e in chosen.effects if e.process is None for p in e.parameters}
    at = {k: float(v) for k, v in known.items() if k in mine} | dict(chosen.starts)
    return {k: v for k, v in at.items() if k[0] not in base.ids}


def as_seen(base: Sequence[Fitted], chosen: Specification) -> bool:
    """Whether fits look at their recordings as the model does."""
    return tuple(view_of(f.case) for f in base) == chosen.views


def document_of(chosen: Specification) -> dict[str, Any]:
    """The model as JSON can hold it (contract: ``model``)."""
    o = chosen.options
    return {
        "effects": [_effect_document(chosen, e) for e in chosen.effects if e.process is None],
        "noise_effects": [e.id for e in chosen.effects if e.process is not None],
        "recordings": [_view_document(v) for v in chosen.views],
        "options": {
            "height": o.height,
            "noise": dict(o.fixed),
            "ignore": list(o.ignore),
            "reference_exact": o.reference_exact,
        }
        | ({} if o.latitude is None else {"latitude": o.latitude}),
        "levels": [dict(levels) for levels in chosen.levels],
    } | ({"begin": chosen.begin} if chosen.begin else {})


def _effect_document(chosen: Specification, e: Effect) -> dict[str, Any]:
    out: dict[str, Any] = {"id": e.id}
    start = {p.name: chosen.starts[e.id, p.name] for p in e.parameters
             if (e.id, p.name) in chosen.starts}  # fmt: skip
    if start:
        out["start"] = start
    if not e.last:
        out["last"] = False
    if e.id in chosen.moments:
        out["moment"] = {"at": chosen.moments[e.id].at, "sigma": chosen.moments[e.id].sigma}
    if e.made is not None:
        out["made"] = {"kind": e.made[0], "numbers": list(e.made[1])}
    elif "+=" in e.id:
        out["prior"] = e.parameters[0].prior_sigma
    return out


def _view_document(v: View) -> dict[str, Any]:
    return {
        "samples": v.samples,
        "observations": list(v.kinds),
        "assume": v.assume,
        "hand": "creeping" if v.creeps else "resting" if v.assume == "rest-only" else "held",
        "left_out": [
            {"observation": e.kind, "rows": list(e.dropped), "log_evidence": e.constant}
            | ({} if e.shifted is None else {"shifted": list(e.shifted)})
            for e in v.edits
        ],
        "warnings": list(v.warnings),
    }
