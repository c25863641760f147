"""The estimator: from what is observed to one fit, the same for every command.

Reading order: ``problem`` (recording, effects and observations as one state), ``filter`` (the loop
around which all is built), ``linear`` and ``evidence`` (the same about a fixed trajectory),
``observed`` and ``case`` (a recording made ready), ``fit`` (effects fitted to recordings),
``quadratic`` (evidence of every subset from one pass), ``specification`` (a model as it is written
down, and its fit from a start of its own), ``result``, ``calibration``.
"""
