"""The search for a better model of the same recordings: every move is taken if, and only if,
``handcal.model_score`` rises.

Reading order: ``response`` (the one matrix of a fit), ``select`` and ``select_laws`` (what explains
best, by the matrix alone), ``noise_scan`` (looks of the filter), ``beyond_columns`` (what no matrix
shows), ``climb`` (turn by turn to the likeliest model), ``multistart`` (where climbs begin, and
which end counts); ``candidates``, ``space`` and ``jumps`` (names on trial, and the evidence of
every subset); ``plausible``; ``outliers``, ``wide_sway``, ``drifting_point`` and
``hand_assumption`` (wrong readings, what the hand did); ``budget``.
"""
