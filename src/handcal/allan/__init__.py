"""Noise of a device at rest: overlapping Allan deviation, and the noise terms that make it up.

The estimator, its degrees of freedom and its confidence bands are in ``overlapping.py``.
The terms are those of IEEE Std 952 (annex C) and 647: the Allan variance of a rate is

    3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3 + R^2 tau^2 / 2

Q quantisation, N white noise (random walk of angle or velocity), B bias instability,
K random walk of the rate, R ramp. They are found by maximum likelihood: an estimate of
variance is a scaled chi-square with its degrees of freedom, scale by octave of tau.
"""

import sys

from handcal import AlsoAFunction

sys.modules[__name__].__class__ = AlsoAFunction
