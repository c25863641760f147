"""The words and units in which results are shown, the same in terminal, report and dashboard.

``shown`` turns an SI unit into the one a person thinks in; ``verdict``, ``nis_word`` and
``not_shown`` say in sentences what the numbers mean. Nothing here formats for a medium.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from handcal.effects import catalogue
from handcal.estimate.noise_levels import white_levels
from handcal.recordings.streams import STREAMS
from handcal.types import Innovations, NoiseLevel, Parameter, Result
from handcal.units import DEG, Shown, shown

NBSP = "\u00a0"
INFLATED = 5.0
STRAYED = 6.0  # sigma; of thousands of looks at an honest estimate hardly one gets there
# Title, and the motion that shows it ({axis}: the names concerned), of the baseline, which has
# no file in the catalogue; the effects' own files say theirs.
_BASELINE: dict[str, tuple[str, str]] = {
    "gyro_bias": ("Gyro bias", "rests, and turns about more than one axis"),
    "accel_bias": ("Accelerometer bias", "rests with {axis} pointing up, down and level"),
}
# What shows the gyro's bias beside a reference, and what is to be said of both biases.
_BESIDE = "rests"
_REFERENCE_TOO = (
    ", for the reference has a bias of its own, which only rests show (--reference-exact where it "
    "has none)"
)

_NOISE = {
    "gyro_noise": "Gyro noise",
    "accel_noise": "Accelerometer noise",
    "heading_noise": "Heading noise",
    "hand_sway": "Hand sway",
    "creep": "Slow drift of the arm",
    "creep_time": "The arm drifts within",
    "sway": "Hand sway",
    "sway_per_rate": "Hand sway while turning",
    "sway_time": "Hand sway lasts",
    "position_noise": "Jitter of the held point",
    "velocity_noise": "Velocity at rest",
    "rest_rate_noise": "Rate noise at rest",
    "mag_noise": "Magnetometer noise",
    "mag_disturbance": "Magnetic disturbance",
}

_ASSUME = {
    "fixed-point": "the held point stayed in its place",
    "rest-only": "the device stood still in the detected rests alone",
}


@dataclass(frozen=True)
class Verdict:
    """level "good", "partly" or "poor"; a headline; the sentences that follow it."""

    level: str
    headline: str
    sentences: tuple[str, ...]


def shown_group(parameters: Sequence[Parameter]) -> Shown:
    """One friendly unit for all parameters of an effect that share an SI unit."""
    return shown(parameters[0].unit, [v for p in parameters for v in (p.value, p.sigma)])


def residual_units(innovations: Innovations) -> tuple[Shown, ...]:
    """The friendly unit of each channel's residuals; angles always in degrees.

    A kind with several units ("m, rad") has as many channels of each.
    """
    units, d = innovations.unit.split(", "), len(innovations.channels)
    found = []
    for c in range(d):
        unit = units[c * len(units) // d]
        typical = sorted(float(s) for s in innovations.sigma[:, c])[innovations.t.size // 2 :]
        found.append(Shown("deg", DEG) if unit == "rad" else shown(unit, typical[:1]))
    return tuple(found)


def channel_labels(channels: Sequence[str]) -> tuple[str, ...]:
    """What tells the channels of one kind apart: "x"; "position x"; nothing for a single one."""
    if len(channels) == 1:
        return ("",)
    alike = len({c.rpartition("_")[0] for c in channels}) == 1
    return tuple(c.rpartition("_")[2] if alike else c.replace("_", " ") for c in channels)


def by_effect(parameters: Sequence[Parameter]) -> dict[tuple[str, str], list[Parameter]]:
    """Parameters grouped by (effect, SI unit), in their order."""
    groups: dict[tuple[str, str], list[Parameter]] = {}
    for p in parameters:
        groups.setdefault((p.effect, p.unit), []).append(p)
    return groups


def effect_title(effect: str) -> str:
    """The effect's name for people; an unknown id with its underscores taken out."""
    return _effect(effect)[0]


def effect_motion(effect: str) -> str:
    """The motion that shows it, as half a sentence."""
    return _effect(effect)[1].rstrip(".").replace("{axis}", "each axis")


def _effect(effect: str) -> tuple[str, str]:
    """Title and motion."""
    if (known := catalogue().get(effect)) is not None:
        return known.title.removesuffix(" error"), known.motion[:1].lower() + known.motion[1:]
    unknown = (effect.replace("_", " ").capitalize(), "a longer and more varied motion")
    return _BASELINE.get(effect, unknown)


def parameter_name(p: Parameter) -> str:
    """The name beside its effect's title; empty where it would only repeat that."""
    return "" if effect_title(p.effect).lower().endswith(" " + p.name.lower()) else p.name


def parameter_title(p: Parameter) -> str:
    """ "Gyro bias x", "Heading delay"."""
    return f"{effect_title(p.effect)} {parameter_name(p)}".rstrip()


def noise_line(level: NoiseLevel) -> tuple[str, str, str]:
    """(title, value in a friendly unit, where it comes from)."""
    unit = shown(level.unit, [level.value])
    title = _NOISE.get(level.name, level.name.replace("_", " ").capitalize())
    source = "found in this recording" if level.estimated else "assumed"
    return title, f"{unit.value(level.value)}{NBSP}{unit.unit}", source


def stream_title(name: str) -> str:
    """The stream's name for people."""
    return STREAMS[name].title if name in STREAMS else name


def kind_name(kind: str) -> str:
    """The kind of observation as the JSON calls it; for people, without the underscore."""
    return {"fixed_position": "position", "zero_velocity": "velocity"}.get(kind, kind)


def kind_title(kind: str) -> str:
    """The same in words."""
    return kind_name(kind).replace("_", " ")


def assume_sentence(
    assume: str, streams: Iterable[str] = (), *, drifts: bool = False, moves: bool = False
) -> str:
    """What the filter took for granted about the hand, with these streams beside the IMU's; drifts,
    moves: whether a held point may."""
    if "reference" in streams:
        return "Nothing was assumed of the hand: the reference tells how it moved."
    if "pose" in streams and assume == "fixed-point":
        return "Nothing was assumed of the hand: the pose tells where it was."
    if assume != "fixed-point" or not (drifts or moves):
        return f"It was assumed that {_ASSUME.get(assume, assume)}."
    place = "drifts smoothly" if drifts else "stayed in its place"
    but = " but for the moves that the warnings list" if moves else ""
    return f"It was assumed that the held point {place}{but}."


def nis_word(innovations: Innovations) -> str:
    """Whether the filter's own error bounds agree with what it saw.

    Thousands of updates make a chi-square test reject models that are perfectly
    usable, so "consistent" is NIS per degree of freedom from 0.5 to 1.6: sigmas
    right to about a quarter.
    """
    mean = innovations.mean_nis
    if mean is None:
        return "no data"
    return "too confident" if mean > 1.6 else "too cautious" if mean < 0.5 else "consistent"


def nis_sentence(kind: str, innovations: Innovations) -> str | None:
    """What a NIS away from one means for the numbers above; None where it is consistent."""
    word, mean = nis_word(innovations), innovations.mean_nis
    if mean is None or word == "consistent":
        return None
    title = kind_title(kind)
    if word == "too confident":
        return (
            f"The {title} observations scatter {math.sqrt(mean):.1f} times as far as the filter "
            f"expects: true errors may be that much larger than the ± values."
        )
    return (
        f"The {title} observations agree {1 / math.sqrt(mean):.1f} times better than the filter "
        f"expects: the ± values are on the large side."
    )


def strayed(result: Result) -> tuple[str, ...]:
    """A sentence for each effect whose estimate moved further than its own sigmas allow.

    An estimate at t and the final one differ with the variance P(t) - P(end) if the model
    holds (Hausman's test); looked at in the second half of the recording.
    """
    h, sentences = result.history, []
    late = h.t >= 0.5 * (h.t[0] + h.t[-1])
    for group in by_effect(result.parameters).values():
        worst: tuple[float, Parameter, float] | None = None
        for p in group:
            c = result.parameters.index(p)
            moved = abs(h.parameters[late, c] - h.parameters[-1, c])
            floor = 0.5 * h.parameter_sigma[-1, c] ** 2
            spread = (h.parameter_sigma[late, c] ** 2 - h.parameter_sigma[-1, c] ** 2).clip(floor)
            ratio = moved / spread**0.5
            at = int(ratio.argmax())
            if p.observable and ratio[at] > STRAYED and (worst is None or ratio[at] > worst[0]):
                worst = (float(ratio[at]), p, float(moved[at]))
        if worst is not None:
            _, p, moved_by = worst
            unit = shown_group(group)
            by = f"{unit.value(moved_by, p.sigma)}{NBSP}{unit.unit}"
            sentences.append(
                f"{parameter_title(p)} moved by {by} in the second half, more than its ± values "
                f"allow: it changes, or it stands in for "
                f"an effect that the model lacks."
            )
    return tuple(sentences)


def inflated(result: Result) -> tuple[str, ...]:
    """A sentence for each sensor whose noise had to be taken far above what its readings show."""
    if result.recording.imu.t.size < 100:
        return ()
    shown_by_readings, sentences = white_levels(result.recording), []
    for n in result.noise:
        ratio = n.value / shown_by_readings.get(n.name, math.inf)
        if n.estimated and ratio > INFLATED:
            title = _NOISE.get(n.name, n.name)
            sentences.append(
                f"{title} had to be taken {ratio:.0f} times as large as the readings show, to "
                f"make up for something that the model lacks; the ± values include that."
            )
    return tuple(sentences)


def counted(n: int, noun: str) -> str:
    """ "1 rest", "2 rests"."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def listed(items: Sequence[str], last: str = "and") -> str:
    """ "a, b and c"."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}"


def _known_to(parameters: Sequence[Parameter]) -> str:
    worst, unit = max(p.sigma for p in parameters), shown_group(parameters)
    title = effect_title(parameters[0].effect).lower()
    return f"{title} ±{unit.value(worst, worst)}{NBSP}{unit.unit}"


def verdict(result: Result) -> Verdict:
    """What was learnt, and whether it can be trusted, in a few sentences."""
    learnt = [p for p in result.parameters if p.observable]
    biases = [p for p in result.parameters if p.effect in ("gyro_bias", "accel_bias")]
    n, of = len(learnt), len(result.parameters)
    doubts = [s for k, i in result.innovations.items() if (s := nis_sentence(k, i))]
    lacking = [*strayed(result), *inflated(result)]
    if not result.settled:
        lacking.append("The estimate had not come to rest when it was given up.")
    doubts += lacking
    overconfident = bool(lacking) or any(
        nis_word(i) == "too confident" for i in result.innovations.values()
    )
    beside = bool(learnt) and "known_input" in result.innovations
    if not (beside or any(p.observable for p in biases)):
        level, headline = "poor", "This motion did not show the sensor's biases."
    elif n == of and not overconfident:
        level, headline = "good", "Every parameter was learnt, and the numbers hold together."
    elif overconfident:
        level, headline = "partly", "Something in this recording is not explained by the model."
    else:
        level, headline = "partly", f"{n} of {of} parameters were learnt from this motion."
    sentences: list[str] = []
    groups = [g for g in by_effect(learnt).values() if len(g) and g[0].unit]
    if groups:
        known = listed([_known_to(g) for g in groups])
        sentences.append(f"If the model is complete, known to one sigma: {known}.")
    if result.innovations and not doubts:
        sentences.append("The residuals match the predicted uncertainty.")
    sentences += doubts
    if overconfident and not result.repeated:
        sentences.append(
            "Usual causes: a held point that moved, or an effect that --effects did not include: "
            "handcal explain tries them all."
        )
    return Verdict(level, headline, tuple(sentences))


def not_shown(result: Result) -> tuple[str, ...]:
    """A sentence for each effect that this motion left unknown, with what would show it."""
    sentences = []
    heading = "heading" in result.innovations or "magnetometer" in result.innovations
    reference = "known_input" in result.innovations
    for (effect, _), group in by_effect(result.parameters).items():
        hidden = [p for p in group if not p.observable]
        if not hidden:
            continue
        names = listed([p.name for p in hidden])
        best, unit = min(hidden, key=lambda p: p.sigma / p.prior_sigma), shown_group(group)
        motion = _effect(effect)[1].format(axis=names).rstrip(".")
        subject = listed([parameter_title(hidden[0]), *(p.name for p in hidden[1:])])
        now, before = unit.value(best.sigma, best.sigma), unit.value(best.prior_sigma)
        why = f"{subject}: ±{now}{NBSP}{unit.unit} now, against ±{before}{NBSP}{unit.unit} before"
        if reference and effect in _BASELINE:
            motion = (_BESIDE if effect == "gyro_bias" else motion) + _REFERENCE_TOO
        elif effect == "gyro_bias" and not heading:
            motion += (
                ". Without a heading, the bias of the axis that stays vertical looks like a slow "
                "turn: turn about a second axis too, or record a magnetometer or compass heading"
            )
        sentences.append(f"{why}. What would show it: {motion}.")
    return tuple(sentences)
