"""Strange accelerometers: laws of their own force, of other load, of turning, heat and time."""

from __future__ import annotations

from functools import partial

from handcal_sim.strange import memory, over_time, still
from handcal_sim.strange.law import stated

_law = partial(stated, "accel")


OWN = (
    _law(still.square, "f_i", "The two capacitor gaps are unequal."),
    _law(still.cubic, "f_i", "Flexures stiffen as they bend."),
    _law(still.quintic, "f_i", "Electrostatic softening leaves the next odd order."),
    _law(still.size_cubed, "f_i", "A rectifying detector of third order."),
    _law(still.one_sided_square, "f_i", "The mass nears its stop on one side only."),
    _law(still.soft_limit, "f_i", "A soft bumper takes up load by and by."),
    _law(still.hard_limit, "f_i", "The mass reaches its stop."),
    _law(still.one_sided_limit, "f_i", "The amplifier reaches one rail."),
    _law(still.dead_zone, "f_i", "Surface forces hold the mass near its middle."),
    _law(still.missing_codes, "f_i", "A capacitor of the converter fails: codes are missing."),
    _law(still.friction, "f_i", "The mass rubs, and rests on one side or the other."),
    _law(still.stribeck, "f_i", "Sticking near the middle fades with load."),
    _law(still.range_change, "f_i", "The wide range of an automatic one has its own offset."),
    _law(still.latch_point, "f_i", "A charge is injected where the converter changes bit."),
    _law(still.staircase, "f_i", "Far too few bits."),
    _law(still.ripple, "f_i", "Segments of the converter are uneven."),
    _law(still.resonance, "f_i", "At one load the mass meets a burr."),
    _law(still.leak, "f_i", "A protection diode begins to conduct at one rail."),
    _law(still.root, "f_i", "Squeezed gas leaks with the root of pressure."),
)
PAST = (
    _law(memory.settling, "past f_i", "The adhesive creeps under load."),
    _law(memory.settling_size, "past f_i", "A detector's capacitor empties slowly."),
    _law(memory.overshoot, "past f_i", "The loop filter has too much lead."),
    _law(memory.absorption, "past f_i", "Dielectric absorption in the hold capacitor."),
    _law(memory.play, "past f_i", "The mass has play in its suspension."),
    _law(memory.stiction, "past f_i", "The mass sticks until the load has changed enough."),
    _law(memory.hysteresis, "past f_i", "The spring's material has a hysteresis loop."),
    _law(memory.remanence, "past f_i", "The mass clings to the side on which it last lay."),
    _law(memory.peak_hold, "past f_i", "The automatic gain follows the largest load."),
    _law(memory.recovery, "past f_i", "An amplifier recovers slowly from overload."),
    _law(memory.slow_fall, "past f_i", "A fluid lets the mass down more slowly than up."),
    _law(memory.slew_limit, "past f_i", "The output stage slews no faster."),
    _law(memory.echo, "past f_i", "A ring buffer lets old samples through."),
    _law(memory.ringing, "past f_i", "The board hangs in foam and swings on."),
)
LOAD = (
    _law(still.excess, "f_j", "Load across the axis counts once a stop is touched."),
    _law(still.size, "f_k", "The frame bows under load across, whichever way."),
    _law(still.square, "f_j", "Bending under load across is of second order."),
    _law(still.cubic, "f_k", "The neighbour's distortion couples in."),
    _law(still.friction, "f_j", "The die tips from one corner to the other."),
    _law(still.times_size, "f_i, f_j", "The gain falls under load across of either sign."),
    _law(still.times_square, "f_i, f_k", "The gain falls with the square of load across."),
    _law(still.times_sign, "f_i, f_j", "The scale differs between two ways of lying."),
    _law(still.triple, "f_i, f_j, f_k", "A mass on a membrane mixes three directions."),
    _law(still.limited_product, "f_j, f_k", "A multiplier in the decoupling saturates."),
    _law(memory.settling, "past f_j", "The lid creeps under load across."),
    _law(memory.play, "past f_k", "The mass has play across its axis."),
    _law(memory.remanence, "past f_k", "A particle lies on the side that was last below."),
    _law(still.size, "jerk_i", "Changes of load are rectified."),
    _law(still.linear, "jerk_j", "Piezoelectric charge by changes of load across."),
    _law(still.friction, "jerk_i", "Dry friction: the reading is pulled the way it moves."),
    _law(still.cubic, "jerk_i", "The lag grows where load changes fast."),
    _law(memory.vibration, "past f_j", "Shaking across the axis is rectified."),
)
TURNING = (
    _law(still.linear, "|omega|", "Air carried along with the case presses on the mass."),
    _law(still.excess, "|omega|", "Beyond a rate the supply, shared with the gyro, gives way."),
    _law(still.root_of_size, "|omega|", "Turbulence in the gas sets in early."),
    _law(still.linear, "omega_j", "The gyro's drive on the same die leaks in."),
    _law(still.size, "omega_k", "The gyro's rectified drive leaks in."),
    _law(still.square, "omega_i", "Gas is flung outwards about the axis itself."),
    _law(still.cubic, "omega_j", "The gyro's distortion leaks in."),
    _law(still.friction, "omega_i", "A loose ring on the axis is dragged along."),
    _law(still.saturated, "omega_k", "The gyro's clipped output couples in."),
    _law(still.product, "omega_i, f_j", "The mass is a gyroscope of its own."),
    _law(still.times_size, "f_i, omega_j", "The gain falls while the gyro draws current."),
    _law(still.product, "f_i, |omega|", "The gain falls with the current of all gyro axes."),
    _law(still.times_sign, "f_k, omega_i", "The mass leans the way it is turned."),
    _law(still.linear, "alpha_i", "A wheel on the axis reacts to spinning up."),
    _law(still.size, "alpha_i", "Spinning up is rectified."),
    _law(still.square, "alpha_k", "A hinge bends with the square of angular acceleration."),
    _law(still.linear, "|alpha|", "Any angular acceleration shakes the mass."),
    _law(memory.settling, "past omega_j", "A fluid in the case circulates on."),
    _law(memory.overshoot, "past |omega|", "A fluid sloshes as turning changes."),
)
HEAT = (
    _law(still.square, "T", "Compensation is linear, the drift is not."),
    _law(still.knee, "T", "A lacquer softens at one temperature."),
    _law(still.latch_point, "T", "The compensation table jumps between two entries."),
    _law(memory.behind, "past T", "The die lags the thermometer: a gradient strains it."),
    _law(memory.rate_of_change, "past T", "Thermal flux, not temperature, bends the frame."),
    _law(memory.play, "past T", "Solder yields: warming and cooling differ."),
    _law(still.product, "f_i, T", "The scale factor changes with temperature."),
    _law(memory.warming_up, "past f_i", "Power of the rebalance loop heats the die."),
    _law(memory.warming_up, "past |omega|", "Power of the gyro next door heats the die."),
    _law(memory.heated_gain, "f_i, past |omega|", "Heat of the gyro changes the scale."),
)
PLACE = (
    _law(still.once, "heading", "A part of iron pulls towards north."),
    _law(still.twice, "heading", "A magnetised shield bends with the square of the field."),
    _law(still.linear, "north_k", "The mass carries a magnet."),
    _law(still.square, "north_j", "Magnetostriction goes with the square of the field."),
    _law(still.six_times, "tilt", "A ball bearing's six balls roll as the device tilts."),
    _law(still.narrow_lobe, "tilt", "At one tilt a lead touches the case."),
    _law(still.product, "f_i, north_j", "A magnet on the spring changes its stiffness."),
)
TIME = (
    _law(over_time.start_up, "t", "A charge on the electrodes leaks away after switching on."),
    _law(over_time.ringing_start, "t", "The supply swings in after switching on."),
    _law(over_time.hum, "t", "An engine's vibration is seen slowed down by sampling."),
    _law(over_time.beat, "t", "Two clocks on the board beat."),
    _law(over_time.on_and_off, "t", "A motor in the phone is switched."),
    _law(over_time.sawtooth, "t", "Automatic zeroing resets a drift now and then."),
    _law(over_time.bursts, "t", "A radio transmits a few times."),
    _law(over_time.loose_contact, "t", "A solder joint makes contact at times."),
    _law(over_time.drifting_gain, "f_i, t", "The battery empties, and the gain with it."),
    _law(over_time.gain_jump, "f_i, t", "The driver changes its range setting once."),
    _law(over_time.gain_flutter, "f_i, t", "The reference voltage swings."),
)
LAWS = (*OWN, *PAST, *LOAD, *TURNING, *HEAT, *PLACE, *TIME)
