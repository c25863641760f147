"""The one score by which models of the same recordings are compared: what their evidence is worth,
and their prior odds. Every step of the search is taken if, and only if, it rises."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from handcal.effects import Effect
from handcal.estimate.case import Case
from handcal.estimate.model import Model
from handcal.estimate.trajectory import LONGEST

# Log prior odds that a device shows an effect so clearly that it has to be told.
PRIOR = -5.0
# What it costs that a noise level is not known.
OCCAM_LEVEL = 2.5
# Laws without a name that are on trial (channels and drivers), among which one effect's odds are
# shared.
LAWS = 1000
TERM_PRIOR = PRIOR - math.log(LAWS)
# Errors that go with the motion that are on trial: two ways, on seven sets of axes of two sensors
# and on the heading.
WITH_MOTION = 30
# Moments of a step that are on trial; and length of the short windows of errors, s, an epoch at
# the least, and the largest count of them.
MOMENTS = 16
WINDOW, MOST_WINDOWS = LONGEST, 450
# A name is clear when it has that share of the set that could stand in its place.
NAMED = 0.9
# Nats of evidence that a fit may gain after it came to rest, or sank twice, at the noise levels of
# the model it is compared with: of 153 fits that rested 30 or more below it none ended above, but
# with a noise effect more.
GAINED = 50.0
# Nothing is surer than that.
CERTAIN = 0.999999


def probability(gain: float) -> float:
    """Posterior probability of an effect that gains so many nats, on its own."""
    return 1.0 / (1.0 + math.exp(-min(700.0, gain + PRIOR)))


def prior(effect: Effect, cases: Sequence[Case]) -> float:
    """Log prior odds of an effect in these recordings.

    Noise pays for its unknown levels. A step shares its odds over the moments on trial (an IMU's:
    all short windows); where it was put at the reading that was least expected, all readings were
    looked at. What a hand that turns the device about no single point can lend to an effect counts
    where only that point's rest tells of it. A law without a name pays for what its form was chosen
    from. What every device has costs nothing.
    """
    if effect.common:
        return 0.0
    if effect.process is not None and effect.passing:
        return PRIOR - math.log(WITH_MOTION) - OCCAM_LEVEL * len(effect.levels)
    if "+=" in effect.id:
        return TERM_PRIOR - effect.cost
    odds = PRIOR - OCCAM_LEVEL * len(effect.levels)
    if "@" in effect.id:
        odds -= math.log(_moments(effect, cases))
    if any("fixed_position" in case.kinds for case in cases):
        odds -= effect.imitated
    return odds


def _moments(effect: Effect, cases: Sequence[Case]) -> int:
    if effect.imu_error is not None:
        windows = min((case.recording.duration_s for case in cases), default=0.0) / WINDOW
        return int(min(max(windows, MOMENTS), MOST_WINDOWS))
    if not effect.held:
        return MOMENTS
    observed = [(o, rows) for case in cases for o, rows, _ in case.observed]
    return max(1, sum(len(r.t) for o, r in observed if o.kind in effect.acts_on))


def log_prior(effects: Iterable[Effect], cases: Sequence[Case]) -> float:
    """Log prior odds of a set of effects."""
    return sum(prior(e, cases) for e in effects)


def of_use(than: Model | None, effects: Iterable[Effect], worth: float) -> float:
    """Log-evidence below which a fit of these effects, at a model's noise levels, comes to no
    better score than that has; than: the model (None: any fit is of use)."""
    if than is None:
        return -math.inf
    odds = log_prior(effects, [f.case for f in than.parts])
    return (score(than, worth) - odds) / worth - GAINED


def score(model: Model, worth: float) -> float:
    """Log-evidence at its worth, and log prior odds, nats."""
    return worth * model.log_evidence + log_prior(model.effects, [f.case for f in model.parts])


def better(a: Model, b: Model, worth: float) -> float:
    """Nats by which one model's score is above another's."""
    return score(a, worth) - score(b, worth)
