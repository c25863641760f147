"""Strange gyros: laws of their own rate, of other motion, of force, heat, place and time."""

from __future__ import annotations

from functools import partial

from handcal_sim.strange import memory, over_time, still
from handcal_sim.strange.law import stated

_law = partial(stated, "gyro")


OWN = (
    _law(still.size, "omega_i", "Drive and sense differ in gain for the two senses of turning."),
    _law(still.cubic, "omega_i", "Flexures stiffen as they bend."),
    _law(still.quintic, "omega_i", "A loop that cancels the cubic leaves the next odd order."),
    _law(still.size_cubed, "omega_i", "A detector that is square in amplitude and uneven in sign."),
    _law(still.one_sided_square, "omega_i", "One comb finger nears its stop on one side only."),
    _law(still.root, "omega_i", "Flow through a leak goes with the root of pressure."),
    _law(still.soft_limit, "omega_i", "The rebalance loop runs out of force by and by."),
    _law(still.hard_limit, "omega_i", "A range set too small clips."),
    _law(still.one_sided_limit, "omega_i", "The supply is too low for one sign of the output."),
    _law(still.dead_zone, "omega_i", "Firmware takes small rates for rest."),
    _law(still.missing_codes, "omega_i", "A comparator of the converter fails: codes are missing."),
    _law(still.friction, "omega_i", "Coulomb friction in a bearing changes sign with the rate."),
    _law(still.stribeck, "omega_i", "Dry friction that lubricates itself as it moves."),
    _law(still.range_change, "omega_i", "The wide range of an automatic one has its own offset."),
    _law(still.latch_point, "omega_i", "A charge is injected where the converter changes bit."),
    _law(still.staircase, "omega_i", "Far too few bits."),
    _law(still.ripple, "omega_i", "Interpolation between converter segments is uneven."),
    _law(still.resonance, "omega_i", "At one rate a mode of the package locks in."),
    _law(still.detuned, "omega_i", "Lock-in of a ring laser: small rates pull, large ones do not."),
    _law(still.leak, "omega_i", "A protection diode begins to conduct at one rail."),
)
PAST = (
    _law(memory.settling, "past omega_i", "A viscoelastic die bond creeps after every turn."),
    _law(memory.settling_size, "past omega_i", "A detector's capacitor empties slowly."),
    _law(memory.overshoot, "past omega_i", "The loop filter has too much lead."),
    _law(memory.absorption, "past omega_i", "Dielectric absorption in the integrating capacitor."),
    _law(memory.play, "past omega_i", "A gear between motor and sensor has play."),
    _law(memory.stiction, "past omega_i", "Output is sent only when it has changed enough."),
    _law(
        memory.hysteresis, "past omega_i", "The magnetic path of a torquer has a hysteresis loop."
    ),
    _law(
        memory.remanence, "past omega_i", "A torquer stays magnetised the way it was last driven."
    ),
    _law(memory.peak_hold, "past omega_i", "The automatic gain follows the largest rate."),
    _law(memory.recovery, "past omega_i", "An amplifier recovers slowly from overload."),
    _law(memory.slow_fall, "past omega_i", "A rectifier charges fast and empties slowly."),
    _law(memory.slew_limit, "past omega_i", "The output stage slews no faster."),
    _law(memory.echo, "past omega_i", "A ring buffer lets old samples through."),
    _law(memory.ringing, "past omega_i", "The board hangs in foam and swings on."),
)
MOTION = (
    _law(still.linear, "|omega|", "The drive mode loses amplitude to any turning."),
    _law(still.square, "|omega|", "Centrifugal load of all axes shifts the mode's frequency."),
    _law(still.excess, "|omega|", "Beyond a rate of any axis the supply gives way."),
    _law(still.root_of_size, "|omega|", "Noise of turning is rectified in amplitude."),
    _law(still.square, "omega_j", "Centrifugal force about another axis bends the frame."),
    _law(still.size, "omega_j", "The rectified rate of another axis leaks in."),
    _law(still.cubic, "omega_k", "The neighbour's distortion couples capacitively."),
    _law(still.saturated, "omega_j", "The neighbour's clipped output couples in."),
    _law(still.excess, "omega_k", "Cross-talk once the neighbour leaves its linear range."),
    _law(still.friction, "omega_k", "Friction in the neighbour's bearing is felt."),
    _law(still.times_size, "omega_i, omega_j", "The gain changes with the other axis's load."),
    _law(still.product, "omega_i, |omega|", "The gain changes with the load of all axes."),
    _law(still.times_square, "omega_i, omega_k", "Centrifugal stiffening by another axis."),
    _law(still.limited_product, "omega_i, omega_j", "A multiplier in the loop saturates."),
    _law(still.triple, "omega_i, omega_j, omega_k", "Three modes mix in one resonator."),
    _law(still.direction, "omega_j, |omega|", "Normalised amplitudes make the axis's share count."),
    _law(still.gain_beyond, "omega_i, omega_k", "The gain falls once the neighbour overloads."),
    _law(still.linear, "alpha_j", "Angular acceleration about another axis tilts the frame."),
    _law(still.size, "alpha_i", "Angular acceleration is rectified by the demodulator."),
    _law(still.friction, "alpha_i", "A step where the spin-up changes sign: a loose rotor."),
    _law(still.cubic, "alpha_i", "The lag grows where the loop is driven hard."),
    _law(still.linear, "|alpha|", "Any angular acceleration shakes the drive's amplitude."),
    _law(still.product, "alpha_j, omega_k", "A gyroscopic couple of rotor and frame."),
    _law(memory.vibration, "past omega_j", "Shaking of the neighbour is rectified."),
    _law(memory.settling, "past omega_j", "The neighbour's mode rings on and leaks in."),
    _law(memory.drooping_gain, "omega_i, past |omega|", "The supply droops while all axes work."),
)
FORCE = (
    _law(still.excess, "f_j", "Sensitivity to force sets in where a stop is touched."),
    _law(still.excess_size, "f_i", "Beyond a load the suspension bottoms on either side."),
    _law(still.size, "f_j", "The frame bows under load whichever way it acts."),
    _law(still.square, "f_k", "Bending under load is of second order."),
    _law(still.cubic, "f_i", "Stiffening flexures under gravity."),
    _law(still.friction, "f_k", "A loose die falls from one stop to the other."),
    _law(still.product, "f_j, f_k", "Unequal compliance of two axes: anisoelastic drift."),
    _law(still.product, "omega_i, f_k", "The gap, and with it the gain, changes under load."),
    _law(still.times_size, "omega_i, f_j", "The gain falls under load of either sign."),
    _law(still.times_sign, "omega_i, f_i", "The scale differs between face up and face down."),
    _law(memory.settling, "past f_j", "The adhesive creeps under gravity."),
    _law(memory.remanence, "past f_k", "A particle lies on the side that was last below."),
    _law(memory.play, "past f_j", "The mass has play across its axis."),
    _law(still.linear, "jerk_k", "Piezoelectric charge by changes of load."),
    _law(still.size, "jerk_j", "Changes of load are rectified."),
    _law(still.linear, "turn", "A needle of iron inside feels turning in the Earth's field."),
    _law(still.size, "turn", "Eddy currents brake turning across the field either way."),
)
HEAT = (
    _law(still.square, "T", "Compensation is linear, the drift is not."),
    _law(still.knee, "T", "An additive of the mould softens at one temperature."),
    _law(still.latch_point, "T", "The compensation table jumps between two entries."),
    _law(memory.behind, "past T", "The die lags the thermometer: a gradient strains it."),
    _law(memory.rate_of_change, "past T", "Thermal flux, not temperature, bends the frame."),
    _law(memory.play, "past T", "Solder yields: warming and cooling differ."),
    _law(still.product, "omega_i, T", "The scale factor changes with temperature."),
    _law(memory.warming_up, "past omega_i", "The axis's own rebalance power heats it."),
    _law(memory.warming_up, "past |omega|", "Power for all axes heats the die."),
    _law(memory.heated_gain, "omega_i, past |omega|", "The scale changes as power heats the die."),
)
PLACE = (
    _law(still.once, "heading", "The drive feels the Earth's horizontal field."),
    _law(still.twice, "heading", "A shield magnetised by the field acts as its square."),
    _law(still.linear, "north_j", "The drive current is deflected by the Earth's field."),
    _law(still.square, "north_k", "Magnetostriction goes with the square of the field."),
    _law(still.thrice, "tilt", "The package bends about a cable as it is tilted."),
    _law(still.narrow_lobe, "tilt", "At one tilt a lead touches the case."),
    _law(memory.settling, "past north_j", "A soft magnetic part relaxes slowly."),
)
TIME = (
    _law(over_time.start_up, "t", "The drive settles after switching on."),
    _law(over_time.ringing_start, "t", "The temperature control swings in after switching on."),
    _law(over_time.hum, "t", "A vibration beyond the sampling rate is seen slowed down."),
    _law(over_time.beat, "t", "Two drive frequencies beat."),
    _law(over_time.on_and_off, "t", "The display's backlight is switched."),
    _law(over_time.sawtooth, "t", "A self-calibration resets a drift now and then."),
    _law(over_time.bursts, "t", "A radio transmits a few times."),
    _law(over_time.loose_contact, "t", "A solder joint makes contact at times."),
    _law(over_time.drifting_gain, "omega_i, t", "The battery empties, and the gain with it."),
    _law(over_time.gain_jump, "omega_i, t", "The driver changes its range setting once."),
    _law(over_time.gain_flutter, "omega_i, t", "The amplitude control hunts."),
)
LAWS = (*OWN, *PAST, *MOTION, *FORCE, *HEAT, *PLACE, *TIME)
