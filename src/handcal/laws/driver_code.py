"""Drivers as source: what makes a signal of a recording's readings in a law that is written out."""

from __future__ import annotations

from handcal.effects import ROOM
from handcal.laws import operators
from handcal.laws.drivers import TURNING, WARM, YAW

_SINCE_A_TURN = f'''
def since_a_turn(t: Array, gyro: Array) -> Array:
    """Time (n,) since the device was last being turned, s."""
    turned = np.linalg.norm(gyro, axis=1) > {TURNING}
    return t - np.maximum.accumulate(np.where(turned, t, t[0]))

'''
# What a file needs to know of what its code calls.
HELPERS = {"since_a_turn": _SINCE_A_TURN} | {
    name: f"\n{text}\n" for name, text in map(operators.source, operators.OPERATORS)
}
_PLAIN = {
    "|omega|": "np.linalg.norm(signals.gyro, axis=1)",
    "|f|": "np.linalg.norm(signals.accel, axis=1)",
    "(time since a turn)": "since_a_turn(signals.t, signals.gyro)",
    "yaw": "np.arctan2(signals.C_nb[:, 1, 0], signals.C_nb[:, 0, 0])",
    WARM: f"signals.temperature - {ROOM}",
    "|alpha|": "np.linalg.norm(np.gradient(signals.gyro, signals.t, axis=0), axis=1)",
    "|jerk|": "np.linalg.norm(np.gradient(signals.accel, signals.t, axis=0), axis=1)",
    "sin(pitch of x)": "signals.C_nb[:, 2, 0]",
    "sin(pitch of y)": "signals.C_nb[:, 2, 1]",
    "cos(tilt)": "signals.C_nb[:, 2, 2]",
    "(yaw rate)": 'np.einsum("ni,ni->n", signals.C_nb[:, 2], signals.gyro)',
    "t": "signals.t - signals.t[0]",
    "t^2": "(signals.t - signals.t[0]) ** 2",
}
_STREAMS = {"omega": "gyro", "f": "accel", "alpha": "gyro", "jerk": "accel"}


def driver_code(name: str) -> str:
    """A driver of an axis x, y, z, or of each axis {i}, as code that makes it (n,) of ``signals``.
    Raises KeyError for one that there is none of."""
    if name in _PLAIN:
        return _PLAIN[name]
    if found := operators.DIRECTION.fullmatch(name):
        return f"{_signal(found[1])} / np.maximum({_PLAIN['|omega|']}, {found[2]})"
    if found := operators.MIXED.fullmatch(name):
        return f"({driver_code(found[1])} {found[2]} {found[3]} * {driver_code(found[4])})"
    if found := operators.BEARING.fullmatch(name):
        return f"np.cos({_PLAIN['yaw']} - {found[1]})"
    first, rest = operators.factors(name)
    if rest:
        return f"{_factor(driver_code(first))} * {_factor(driver_code(rest))}"
    if name.endswith("^2"):
        return f"({driver_code(name[:-2])}) ** 2"
    if name.startswith("|") and name.endswith("|"):
        return f"np.abs({driver_code(name[1:-1])})"
    if found := operators.SIDE.fullmatch(name):
        return f"np.maximum({found[1]}{driver_code(found[2])}, 0.0)"
    if found := operators.SIGN.fullmatch(name):
        return f"np.tanh({driver_code(found[1])} / {found[2]})"
    return _signal(name)


def steps_to(x: str, name: str) -> list[str]:
    """The same as assignments to x, one for each operator."""
    if (found := operators.parsed(name)) is not None:
        operator, number, signal = found
        op = operators.OPERATORS[operator]
        turns = f", {_PLAIN['|omega|']}" * op.turning
        made = f"{operators.source(operator)[0]}(signals.t, {x}, {number:g}{turns})"
        less = f" - {x}" * op.less
        begun = steps_to(x, signal)
        if signal == YAW.name:
            begun += [f"{x} = np.unwrap({x})"]
        return [*begun, f"{x} = {made}{less}"]
    first, rest = operators.factors(name)
    if rest and operators.remembers(first):
        return [*steps_to(f"{x}_0", first), *steps_to(x, rest), f"{x} = {x}_0 * {x}"]
    if operators.remembers(rest):
        return [*steps_to(x, rest), f"{x} = {_factor(driver_code(first))} * {x}"]
    return [f"{x} = {driver_code(name)}"]


def _signal(name: str) -> str:
    kind, _, axis = name.partition("_")
    columns = {"x": "0", "y": "1", "z": "2", "{i}": "i", "{j}": "(i + 1) % 3", "{k}": "i - 1"}
    if kind == "north":
        return f"signals.C_nb[:, 1, {columns[axis]}]"
    signal = f"signals.{_STREAMS[kind]}[:, {columns[axis]}]"
    return f"np.gradient({signal}, signals.t)" if kind in ("alpha", "jerk") else signal


def _factor(code: str) -> str:
    return f"({code})" if " - " in code else code
