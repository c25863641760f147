"""Locate the mismatch, name the missing physics, model it, prove it.

Reading order: ``pipeline``, all of it from end to end (``handcal.search`` finds the model);
``naming`` (what has a name), ``moments`` (of its moments, the best), ``gauge`` (what turns out to
be a simpler effect), ``leaning`` (what is certain only without something else), ``locate`` (where
the baseline falls short), ``importance`` and ``held_out`` (what matters, and what unseen data say),
``next_motion`` and ``expected_gain``, ``untellable``; ``model_file`` (the model as JSON has it),
and ``assembled``, which puts an Explanation together. Most sentences that people
read are in ``handcal.show.explanation``.
"""

from __future__ import annotations

import sys

from handcal import AlsoAFunction
from handcal.explain.pipeline import explain
from handcal.explanation import Explanation

__all__ = ["Explanation", "explain"]

sys.modules[__name__].__class__ = AlsoAFunction
