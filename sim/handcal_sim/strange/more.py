"""Further strange laws of gyros, accelerometers and headings: which response each has, and why."""

from __future__ import annotations

from functools import partial

from handcal_sim.strange import memory, others, still
from handcal_sim.strange.law import stated

_gyro, _accel, _heading = (partial(stated, sensor) for sensor in ("gyro", "accel", "heading"))

GYRO = (
    _gyro(others.interferometer, "omega_i", "An open optical loop reads the sine of its phase."),
    _gyro(
        others.sleep_and_wake, "past omega_i", "Firmware saves power below one rate, till a higher."
    ),
    _gyro(
        others.sticky_range, "past omega_i", "An automatic range is left later than it was entered."
    ),
    _gyro(
        others.median_window, "past omega_i", "Spikes are taken out by a median over far too much."
    ),
    _gyro(others.automatic_gain, "past omega_i", "Automatic gain levels what it measures."),
    _gyro(
        others.whole_angle, "past omega_i", "A ring's pattern of vibration goes round uneven trims."
    ),
    _gyro(others.frozen, "past omega_i, t", "Writing to flash memory blocks the bus now and then."),
    _gyro(
        others.bias_tracking,
        "past omega_i, past |omega|",
        "Firmware takes slow turning for its bias.",
    ),
    _gyro(
        others.turned_past,
        "past omega_j, past omega_k",
        "Increments are summed as if they commuted.",
    ),
    _gyro(
        others.common_range,
        "omega_i, omega_j, omega_k",
        "All axes share a range, set by the largest.",
    ),
    _gyro(
        others.screen_turned, "past f_j, past f_k", "The screen draws other currents when upright."
    ),
    _gyro(memory.heated_gain, "f_j, past |omega|", "Gas heated by the drives rises past the ring."),
    _gyro(still.product, "alpha_i, T", "A filter's resistor, hence its lag, goes with heat."),
    _gyro(
        others.strained_gain, "omega_i, past T", "A gradient across the die bends its comb fingers."
    ),
)
ACCEL = (
    _accel(others.companded, "f_i", "Readings are sent as a few bits of their logarithm."),
    _accel(
        others.phase_reversal, "f_i", "An amplifier inverts beyond its input's common-mode range."
    ),
    _accel(others.seldom_updated, "past f_i", "In a mode of low power a new value is seldom made."),
    _accel(others.bouncing, "past f_i", "A loose weight falls to the other wall and hops there."),
    _accel(others.sliding, "past f_j", "A battery slides in its tray once this is steep enough."),
    _accel(others.leaning, "f_j, past f_k", "The board leans in its snaps, and slips on in jumps."),
    _accel(
        others.dithered_friction,
        "f_i, past |jerk|",
        "Dry friction, until shaking lets the mass go.",
    ),
    _accel(still.times_square, "jerk_i, f_i", "The film of gas is thinner when the mass is out."),
    _accel(still.product, "jerk_i, |omega|", "Interrupts of the gyro keep the reader waiting."),
    _accel(still.product, "omega_j, north_k", "The lens's coil steadies the picture in a field."),
    _accel(others.tick, "past heading", "The app lets the motor tick at each quarter of its rose."),
    _accel(others.sunlit, "past up_j", "The sun heats one face of the case while it is up."),
    _accel(others.snapping, "past T", "A lid snaps as it warms, and back only when much cooler."),
    _accel(others.sweeping_hum, "t", "A fan runs up, and the alias of its vibration with it."),
)
HEADING = (
    _heading(
        others.captured, "heading", "The app's picture snaps in close to the main directions."
    ),
    _heading(
        others.eased_needle, "past heading", "The app eases: small changes slowly, large ones fast."
    ),
    _heading(others.seam, "past heading", "A bridge tells half circles only: seams are averaged."),
    _heading(
        others.vector_play, "past north_x, past north_y", "Soft iron is dragged behind the field."
    ),
    _heading(others.recentred, "past north_x, north_y", "The app centres on what it saw lately."),
    _heading(memory.overshoot, "past up_x", "Tilt compensation uses a smoothed vertical."),
    _heading(
        others.carried_card, "past turn, past tilt", "Tilted far, the card is held by its glass."
    ),
    _heading(still.wave_times, "heading, T", "A magnet nearby weakens as it warms."),
)
LAWS = (*GYRO, *ACCEL, *HEADING)
