"""Locate the mismatch, name the missing physics, model it, prove it.

Reading order: ``case`` (what is observed), ``fit`` (effects fitted to recordings),
``quadratic`` (evidence of every subset from one pass), ``search``, ``climb`` (the loop),
``find`` (where it begins), ``locate``, ``held``, and ``verdict``, which puts an Explanation
together.
"""

from __future__ import annotations

from handcal.explain.explanation import Explanation
from handcal.explain.verdict import explain

__all__ = ["Explanation", "explain"]
