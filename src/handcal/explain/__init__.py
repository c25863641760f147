"""Locate the mismatch, name the missing physics, model it, prove it.

Reading order: ``pipeline``, all of it from end to end (``handcal.search`` finds the model);
``naming`` (what has a name), ``locate`` (where the baseline falls short), ``importance`` and
``held_out`` (what matters, and what unseen data say), ``next_motion``, ``untellable``, and
``assembled``, which puts an Explanation together. The sentences that people read are in
``handcal.show.explanation``.
"""

from __future__ import annotations

import sys

from handcal import AlsoAFunction
from handcal.explain.pipeline import explain
from handcal.explanation import Explanation

__all__ = ["Explanation", "explain"]

sys.modules[__name__].__class__ = AlsoAFunction
