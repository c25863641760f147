"""Which parameters come in front: biases, and of the errors that every device has those that a
motion showed; and what is said of the others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from handcal.effects import catalogue
from handcal.estimate.parameters import with_shown
from handcal.show.words import by_effect, effect_motion, effect_title, listed, parameter_title
from handcal.types import Parameter

BIASES = ("gyro_bias", "accel_bias")
# Parameters in figures: more hide each other.
MOST_DRAWN = 24


def in_front(
    parameters: Sequence[Parameter], found: Iterable[str] = ()
) -> tuple[list[Parameter], list[Parameter]]:
    """Biases, effects of which something is shown, and effects found or asked for (those that not
    every device has); and the rest."""
    kept = {*BIASES, *with_shown(parameters), *found}
    known = catalogue()
    kept |= {p.effect for p in parameters if p.effect not in known or not known[p.effect].common}
    rest = [p for p in parameters if p.effect not in kept]
    return [p for p in parameters if p.effect in kept], rest


def drawn(parameters: Sequence[Parameter]) -> list[Parameter]:
    """Those that figures show, in their order: all biases, and of the others that are shown whole
    effects, first those furthest from zero in their sigmas."""
    groups = by_effect([p for p in parameters if p.shown or p.effect in BIASES])
    far = {
        key: max(abs(p.value) / max(p.sigma, 1e-300) for p in own) for key, own in groups.items()
    }
    room, out = MOST_DRAWN, set()
    for key in sorted(groups, key=lambda key: (key[0] not in BIASES, -far[key])):
        if len(groups[key]) <= room:
            room -= len(groups[key])
            out.add(key)
    return [p for key, own in groups.items() if key in out for p in own]


def not_drawn(parameters: Sequence[Parameter]) -> str:
    """Which effects that are shown have no figure; empty if all have."""
    left = with_shown(parameters) - with_shown(drawn(parameters))
    names = _names(p for p in parameters if p.effect in left)
    return f"Not drawn, because they are fewer sigmas from zero: {names}." if names else ""


def rest_line(rest: Sequence[Parameter]) -> str:
    """The effects of which nothing is shown, in one sentence; empty if there are none."""
    if not rest:
        return ""
    return (
        f"Not shown by this motion: {_names(rest)}. They keep their prior, which widens the "
        "sigmas of what depends on them."
    )


def rest_motion(rest: Sequence[Parameter]) -> str:
    """What would show most of them; empty if there are none."""
    if not rest:
        return ""
    ((effect, _),) = Counter(p.effect for p in rest).most_common(1)
    return f"Motion that would show most of the rest: {effect_motion(effect)}."


def under_table(front: Sequence[Parameter], rest: Sequence[Parameter]) -> list[str]:
    """Sentences below the table of those in front: of the rest, and why a sigma is beyond the usual
    size."""
    wide = [parameter_title(p) for p in front if p.sigma > p.prior_sigma]
    why = (
        f"± larger than the usual size ({listed(wide)}): this motion does not rule out an error "
        "of many times the usual size, as a few devices have, or its readings scatter more than "
        "the model expects."
    ) if wide else ""  # fmt: skip
    return [s for s in (rest_line(rest), why) if s]


def hardly_any(parameters: Sequence[Parameter]) -> bool:
    """Whether a motion shows neither all biases nor any other error of gyro and accelerometer."""
    biases = [p.shown for p in parameters if p.effect in BIASES]
    others = with_shown(parameters).difference(BIASES) & catalogue().keys()
    return not all(biases) and not any(catalogue()[i].misreads for i in others)


def _names(parameters: Iterable[Parameter]) -> str:
    effects = list(dict.fromkeys(effect_title(p.effect).lower() for p in parameters))
    return listed(effects) if effects else ""
