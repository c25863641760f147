"""A third helping of strange laws of gyros, accelerometers and headings, and why each happens."""

from __future__ import annotations

from functools import partial

from handcal_sim.strange import beyond, memory, others, over_time, still
from handcal_sim.strange.law import stated

_gyro, _accel, _heading = (partial(stated, sensor) for sensor in ("gyro", "accel", "heading"))

GYRO = (
    _gyro(beyond.bit_weight, "omega_i", "One bit of the converter has the wrong weight."),
    _gyro(beyond.gated, "past omega_i", "Firmware clips what strays from its running mean."),
    _gyro(beyond.blanked, "past omega_i", "After an overload, firmware holds its output a while."),
    _gyro(still.product, "f_j, T", "Load makes quadrature, heat the phase by which it leaks in."),
    _gyro(still.linear, "|f|", "Load from any side squeezes the gel in which it is potted."),
    _gyro(
        beyond.shaken_together, "past f_j, past f_k", "Shaking of two axes in step is rectified."
    ),
    _gyro(
        beyond.crept_gain, "omega_i, past f_k", "The package creeps under load: the gap follows."
    ),
    _gyro(
        beyond.seated, "omega_j, past f_k", "The module rocks in its socket, and lies as it fell."
    ),
    _gyro(
        memory.ringing, "past alpha_j", "The mast it stands on twists with every start and stop."
    ),
    _gyro(still.staircase, "T", "The compensation's table is looked up without interpolation."),
    _gyro(over_time.drifting_gain, "omega_j, t", "The die turns slowly in glue that has not set."),
    _gyro(beyond.slips, "t", "Grains of the solder slip a few times, and creep back."),
)
ACCEL = (
    _accel(beyond.single_gap, "f_i", "One capacitor is read alone: it goes with one over its gap."),
    _accel(beyond.leaning_axis, "f_i, f_j", "A pendulum's axis turns with its own deflection."),
    _accel(beyond.higher, "f_j, f_k", "Two neighbours meet through diodes: the higher conducts."),
    _accel(beyond.loaded_friction, "jerk_i, f_j", "A guide rubs as hard as load across presses."),
    _accel(beyond.tunnelling, "past f_i", "Charge tunnels into the oxide where the gap is narrow."),
    _accel(beyond.notched, "past f_i", "A notch meant for a motor is tuned to the hand's shaking."),
    _accel(
        beyond.grabbed, "past f_i, past |omega|", "Offset cancel starts as soon as turning ends."
    ),
    _accel(
        beyond.opened_filter,
        "past f_i, past |omega|",
        "An adaptive filter smooths less while the device turns.",
    ),
    _accel(others.strained_gain, "up_j, past T", "Warmth from the case rises through the gas."),
    _accel(beyond.wound, "past heading", "A cable winds up as the device goes round, and tugs."),
    _accel(over_time.gain_jump, "f_j, t", "The board slips in its slot once, and sits askew."),
    _accel(beyond.log_creep, "t", "Since the screws were tightened the board has been creeping."),
)
HEADING = (
    _heading(beyond.attracted, "heading", "A magnet stands close by in one direction."),
    _heading(beyond.steep_wave, "heading, up_x", "Held steeply, little field is left across it."),
    _heading(beyond.wave_while, "heading, t", "A charger's current on the board comes and goes."),
    _heading(still.wave_times, "heading, |omega|", "Motors that turn it draw current beside it."),
    _heading(
        beyond.not_level, "past omega_z, past turn", "Fusion integrates body z as if it were level."
    ),
    _heading(
        beyond.waiting, "past heading, past |omega|", "No fix is accepted while it turns too fast."
    ),
)
LAWS = (*GYRO, *ACCEL, *HEADING)
