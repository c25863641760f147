"""Whether the held point was held, or the hand travelled and only its rests are still."""

from __future__ import annotations

from dataclasses import replace

from handcal.estimate.case import Case, case_of
from handcal.estimate.hand_sway import TRAVEL_NATS, beyond_a_hand, sway_of
from handcal.estimate.model import Fitted

# How the warning begins where nothing tells a hand that moves from effects that are missing.
DOUBTED = "The hand travels, or effects are missing"


def travels(f: Fitted) -> bool:
    """Whether a point that was taken to be held sways as no hand does, physics or not, and there
    are rests to go by instead."""
    at_rest = f.case.assume == "fixed-point" and len(f.case.rests) > 0
    held = at_rest and "fixed_position" in f.case.kinds
    return held and beyond_a_hand(f.about, f.levels) > TRAVEL_NATS


def doubt(f: Fitted) -> str | None:
    """What to say of a fit in which the point is held and all the same sways as no hand does."""
    if not travels(f):
        return None
    wide = sway_of(f.problem, f.levels)
    return (
        f"The held point would sway by {wide:.2g} m, more than that of a hand which stays in one "
        "place. Either the hand travels, or an error is missing from the model. A recording that "
        "is turned in one place would tell which."
    )


def resting(
    held: Fitted, latitude: float | None, height: float, *, explained: bool = False
) -> Case:
    """The recording with its rests alone taken to be still; held: as if its point were held;
    explained: no physics was found that would have it held."""
    wide = sway_of(held.problem, held.levels)
    read = held.case.read or held.case.recording
    case = case_of(read, "rest-only", latitude, height, (), held.case.fixed,
                   before=held.case.before)  # fmt: skip
    begins = "The hand travels" if explained else DOUBTED
    said = (
        f"{begins}: a fixed held point would sway by {wide:.2g} m. Only the rests are assumed to "
        "be still (--assume fixed-point overrides this)."
    )
    return replace(case, warnings=(*case.warnings, said), noise_until=held.case.noise_until)
