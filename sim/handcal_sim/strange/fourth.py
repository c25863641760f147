"""A fourth helping of strange laws of gyros, accelerometers and headings, and why each happens."""

from __future__ import annotations

from functools import partial

from handcal_sim.strange import over_time, still, yet_more
from handcal_sim.strange.law import stated

_gyro, _accel, _heading = (partial(stated, sensor) for sensor in ("gyro", "accel", "heading"))

GYRO = (
    _gyro(yet_more.mode_crossing, "omega_i, T", "At one temperature drive and sense modes cross."),
    _gyro(yet_more.stronger_wins, "omega_i, omega_j", "A detector locks to the stronger of two."),
    _gyro(yet_more.torn, "past omega_i", "The high byte is from an earlier read than the low one."),
    _gyro(yet_more.windup, "past omega_i", "The rebalance loop winds up while it is at its limit."),
    _gyro(yet_more.creeping_delay, "past omega_i, t", "Clocks differ: a queue fills till dropped."),
    _gyro(yet_more.autozeroed, "past omega_i, t", "A chopper zeroes the amplifier as it moves."),
    _gyro(yet_more.hiccup, "omega_i, past |omega|", "The charge pump gives up, and starts again."),
    _gyro(over_time.gain_flutter, "alpha_i, t", "Time stamps swing as a clock is disciplined."),
    _gyro(
        yet_more.learned_bias,
        "past omega_i, past f_j, past f_k",
        "Fusion learns a bias from force as if it were the vertical.",
    ),
    _gyro(
        yet_more.bead_in_groove,
        "past f_j, past f_k",
        "A bead of solder rolls round in the can, and weighs where it lies.",
    ),
    _gyro(yet_more.run_down, "omega_k, t", "A fan, just switched off, is a gyroscope on the case."),
    _gyro(yet_more.shone_on, "north_j, up_j", "The noon sun shines on the die through a hole."),
)
ACCEL = (
    _accel(yet_more.enveloped, "f_i, f_k", "An amplitude is detected, quadrature and all."),
    _accel(yet_more.late_switch, "f_i, f_j", "The multiplexer slews from its last channel."),
    _accel(yet_more.leaky_hold, "f_i, T", "Leakage from the hold doubles every few kelvin."),
    _accel(yet_more.handed_over, "past f_i", "For large loads the slower sensor of two is read."),
    _accel(yet_more.both_ways, "past f_i", "The logger smooths its file there and back."),
    _accel(yet_more.touched, "past f_j", "At each touch of its stop the mass takes a charge."),
    _accel(yet_more.swung_stop, "past omega_k", "The lens that steadies pictures meets its stop."),
    _accel(still.ripple, "|omega|", "Motors whirr as fast as it turns; sampling aliases that."),
    _accel(yet_more.breathed, "past f_i", "Oil round the mass is driven through a narrow hole."),
    _accel(yet_more.dangling, "past f_j, past f_k", "A charm dangles from the strap's eyelet."),
    _accel(yet_more.leaned_on, "t", "A button is held down: its rubber bends the board."),
    _accel(yet_more.topped_up, "t", "The flash's capacitor is topped up at regular times."),
)
HEADING = (
    _heading(yet_more.saturated_iron, "heading", "A strip of soft iron saturates along itself."),
    _heading(yet_more.eddied, "heading, turn", "The can of the battery is a shorted loop."),
    _heading(
        yet_more.under_compensated,
        "heading, up_x, up_y",
        "Tilt is compensated for the dip of another country.",
    ),
    _heading(yet_more.clipped_channel, "north_x, north_y", "An offset brings one coil to its end."),
    _heading(yet_more.stepped_rose, "past heading", "A weak motor turns the rose of a repeater."),
    _heading(yet_more.driven_past, "t", "A lorry drives past."),
)
LAWS = (*GYRO, *ACCEL, *HEADING)
