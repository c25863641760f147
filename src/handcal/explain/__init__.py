"""Locate the mismatch, name the missing physics, model it, prove it.

Reading order: ``score`` (by which models are compared), ``space`` (the evidence of every subset of
effects from one pass), ``climb`` (the steps from a model to a better one), ``multistart`` (where
climbs begin, and which end counts), ``unnamed`` (laws without a name), ``naming``, ``locate``,
``held_out``, ``conclusions``, which puts an Explanation together, and ``pipeline``, all of it from
end to end. The sentences that people read are in ``handcal.show.explanation``.
"""

from __future__ import annotations

import sys

from handcal import AlsoAFunction
from handcal.explain.explanation import Explanation
from handcal.explain.pipeline import explain

__all__ = ["Explanation", "explain"]

sys.modules[__name__].__class__ = AlsoAFunction
