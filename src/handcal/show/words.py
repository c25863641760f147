"""The words and units in which results are shown, the same in terminal, report and dashboard.

``units.shown`` turns an SI unit into the one a person thinks in. Nothing here formats for a medium;
what the numbers mean is said in ``calibration.verdict_text`` and ``explanation.verdict_text``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from handcal.effects import catalogue
from handcal.recordings.streams import STREAMS
from handcal.types import Innovations, MarkerRotation, NoiseLevel, Parameter
from handcal.units import DEG, Shown, shown

NBSP = "\u00a0"
_SENSORS = {"accel": "accelerometer", "mag": "magnetometer"}
_NOISE = {
    "gyro_noise": "Gyro noise",
    "accel_noise": "Accelerometer noise",
    "heading_noise": "Heading noise",
    "hand_sway": "Hand sway",
    "creep": "Slow drift of the arm",
    "creep_time": "Time constant of the arm's drift",
    "sway": "Hand sway",
    "sway_per_rate": "Hand sway while turning",
    "sway_time": "Time constant of hand sway",
    "position_noise": "Jitter of the held point",
    "velocity_noise": "Velocity at rest",
    "rest_rate_noise": "Rate noise at rest",
    "mag_noise": "Magnetometer noise",
    "mag_disturbance": "Magnetic disturbance",
}

# rad; of directions that have nothing to do with the device's it is pi / sqrt(3), 1.8
_NO_HEADING = 1.0
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
    return _effect(effect)[1].rstrip(".")


def _effect(effect: str) -> tuple[str, str]:
    """Title and motion."""
    if (known := catalogue().get(effect)) is not None:
        return known.title.removesuffix(" error"), known.motion[:1].lower() + known.motion[1:]
    formula = " += " in effect
    title = effect if formula else effect.replace("_", " ").capitalize()
    return title, "a longer and more varied motion"


def parameter_name(p: Parameter) -> str:
    """The name beside its effect's title; empty where it would only repeat that."""
    return "" if effect_title(p.effect).lower().endswith(" " + p.name.lower()) else p.name


def parameter_title(p: Parameter) -> str:
    """ "Gyro bias x", "Compass delay", "k of gyro_x += k * omega_y"."""
    if " += " in p.effect:
        return f"{p.name} of {p.effect}"
    return f"{effect_title(p.effect)} {parameter_name(p)}".rstrip()


def noise_title(name: str) -> str:
    """Of a noise level."""
    if name in _NOISE:
        return _NOISE[name]
    effect = max((i for i in catalogue() if name.startswith(f"{i}_")), key=len, default="")
    if effect:
        return f"{catalogue()[effect].title}, {name.removeprefix(effect + '_')}"
    from handcal.laws.with_motion import of_level  # (which takes as long as all else here)

    found = of_level(name)
    return name.replace("_", " ").capitalize() if found is None else ", ".join(found)


def deaf_heading(noise: Iterable[NoiseLevel]) -> str | None:
    """A sentence where a heading was found to scatter as if it said nothing; None where it does."""
    found = (n.value for n in noise if n.name == "heading_noise" and n.estimated)
    sigma = max(found, default=0.0)
    if sigma <= _NO_HEADING:
        return None
    return (
        f"The heading carries no information: it scatters by {math.degrees(sigma):.0f} deg about "
        "the gyro's, and a random heading by 104 deg. Check its unit (rad), its direction "
        "(counter-clockwise from east) and its clock."
    )


def noise_line(level: NoiseLevel) -> tuple[str, str, str]:
    """(title, value in a friendly unit, where it comes from)."""
    unit = shown(level.unit, [level.value])
    source = "found in this recording" if level.estimated else "assumed"
    return noise_title(level.name), f"{unit.value(level.value)}{NBSP}{unit.unit}", source


def stream_title(name: str) -> str:
    """The stream's name for people."""
    return STREAMS[name].title if name in STREAMS else name


def kind_name(kind: str) -> str:
    """The kind of observation as the JSON calls it; for people, without the underscore."""
    return {"fixed_position": "position", "zero_velocity": "velocity"}.get(kind, kind)


def kind_title(kind: str) -> str:
    """The same in words."""
    return channel_title(kind_name(kind))


def channel_title(channel: str) -> str:
    """ "accelerometer y", "heading"."""
    sensor, _, axis = channel.rpartition("_") if channel[-2:-1] == "_" else (channel, "", "")
    return f"{_SENSORS.get(sensor, sensor.replace('_', ' '))} {axis}".rstrip()


def assume_sentence(
    assume: str, streams: Iterable[str] = (), *, drifts: bool = False, moves: bool = False
) -> str:
    """What the filter took for granted about the hand, with these streams beside the IMU's; drifts,
    moves: whether a held point may."""
    if "reference" in streams:
        return "Nothing was assumed about the hand: the reference measures its motion."
    if "pose" in streams and assume == "fixed-point":
        return "Nothing was assumed about the hand: the pose measures its position."
    if assume != "fixed-point" or not (drifts or moves):
        return f"It was assumed that {_ASSUME.get(assume, assume)}."
    place = "drifts smoothly" if drifts else "stayed in its place"
    but = ", apart from the moves in the warnings" if moves else ""
    return f"It was assumed that the held point {place}{but}."


def counted(n: int, noun: str) -> str:
    """ "1 rest", "2 rests"."""
    return f"{n} {noun_of(n, noun)}"


def noun_of(n: int, noun: str) -> str:
    """ "rest" of one, "rests" of two."""
    return noun if n == 1 else f"{noun}s"


def listed(items: Sequence[str], last: str = "and") -> str:
    """ "a, b and c"."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}"


def marker_sentence(marker: MarkerRotation | None) -> str:
    """How the marker of a pose is turned on the device; empty without a pose."""
    if marker is None:
        return ""
    w, axis = marker.quaternion[0], marker.quaternion[1:]
    length = math.hypot(*axis)
    about = ", ".join(f"{v:.2f}" for v in axis / (length or 1.0))
    degrees = math.degrees(2.0 * math.atan2(length, w))
    sigma = math.degrees(float(marker.sigma.max()))
    return (
        f"The marker's axes are turned by {degrees:.2f}\N{DEGREE SIGN} about ({about}) against "
        f"the IMU's, \N{PLUS-MINUS SIGN} {sigma:.2g}\N{DEGREE SIGN}."
    )
