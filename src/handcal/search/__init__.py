"""The search for a better model of the same recordings: every move is taken if, and only if,
``handcal.model_score`` rises.

Reading order: ``space`` (the evidence of every subset of effects from one pass), ``climb`` (the
steps from a model to a better one), ``multistart`` (where climbs begin, and which end counts);
``noise_scan``, ``outliers`` and ``jumps`` (what is on trial beside the catalogue), ``wide_sway``;
``drifting_point`` and ``hand_assumption`` (what the hand did); ``budget``.
"""
