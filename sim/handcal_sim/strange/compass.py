"""Strange compasses: laws of the heading itself, of needles, tilt, turning, heat and time."""

from __future__ import annotations

from functools import partial

from handcal_sim.strange import memory, over_time, still
from handcal_sim.strange.law import stated

_law = partial(stated, "heading")


CIRCLE = (
    _law(still.thrice, "heading", "Three iron spokes of a card."),
    _law(
        still.four_times, "heading", "Induction in a square frame: the sextantal deviation's kin."
    ),
    _law(still.six_times, "heading", "Six pole pieces of a flux gate."),
    _law(still.rectified_wave, "heading", "A detector that loses the sign of one component."),
    _law(still.half_circle, "heading", "One of two coils changes range with its sign."),
    _law(still.narrow_lobe, "heading", "A screw of the strap lies close in one direction only."),
    _law(still.grid, "heading", "The app draws headings towards the marks of its rose."),
)
NEEDLE = (
    _law(memory.late_needle, "past heading", "The app averages for a steady picture."),
    _law(memory.sticking_needle, "past heading", "A dry pivot lets go in jumps."),
    _law(memory.needle_play, "past heading", "A worn pivot has play."),
    _law(memory.swinging_needle, "past heading", "Too little oil: the needle swings on."),
    _law(memory.settling, "past turn", "The oil, dragged along, turns the needle back slowly."),
    _law(memory.recovery, "past turn", "A filter lets go after fast turns and settles again."),
    _law(still.friction, "turn", "The pivot drags the needle along a little."),
    _law(still.cubic, "turn", "Drag of the oil grows with the cube of the rate."),
    _law(still.excess, "turn", "Beyond a rate the smoothing lags."),
    _law(still.size, "turn", "Eddy currents pull one way whichever way it turns."),
)
TILT = (
    _law(still.linear, "up_x", "The dip of the field leaks in with pitch."),
    _law(still.linear, "up_y", "The dip of the field leaks in with roll."),
    _law(still.square, "up_y", "Tilt compensation lacks its second order."),
    _law(still.product, "up_x, up_y", "Tilt compensation lacks its mixed term."),
    _law(still.friction, "up_z", "Upside down, another calibration is used."),
    _law(still.excess, "up_x", "The card touches its glass beyond a pitch."),
    _law(still.wave_times, "heading, up_y", "Vertical iron: deviation that grows with heel."),
    _law(still.wave_times, "heading, up_z", "Iron below acts the other way upside down."),
    _law(memory.settling, "past up_x", "An air bubble moves slowly as the case is tilted."),
    _law(memory.remanence, "past up_y", "A loose bit of iron lies where it last fell."),
)
OTHER = (
    _law(still.linear, "|omega|", "The gyro's current makes a field."),
    _law(still.linear, "alpha_z", "A pivot off the middle swings with every spin-up."),
    _law(still.product, "turn, up_y", "Northern turning error: tilt and turn together."),
    _law(memory.warming_up, "past |omega|", "Power of the gyro warms the bridge."),
    _law(still.linear, "T", "The bridge's two halves drift apart with temperature."),
    _law(memory.behind, "past T", "A gradient across the bridge."),
    _law(over_time.start_up, "t", "The filter begins far off and settles."),
    _law(over_time.hum, "t", "A rotating machine nearby, seen slowed down."),
    _law(over_time.beat, "t", "Two mains frequencies beat in the loop."),
    _law(over_time.on_and_off, "t", "A load current nearby is switched."),
    _law(over_time.loose_contact, "t", "A magnet in a cover is opened and closed."),
    _law(over_time.bursts, "t", "Trams pass by a few times."),
)
LAWS = (*CIRCLE, *NEEDLE, *TILT, *OTHER)
