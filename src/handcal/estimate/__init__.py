"""From what is observed to one fit, the same for every command.

Reading order: ``observed`` (what is observed of a recording), ``case`` (a recording made ready),
``fit`` (effects fitted to recordings), ``quadratic`` (evidence of every subset from one pass),
``chosen`` (a model as it is written down, and its fit from a start of its own), ``result``.
"""
