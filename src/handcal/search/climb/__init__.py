"""The climb from a model to one that explains more: scan, take a step, fit again.

One step, one function: it returns the model to go on from, or None where there is nothing to
do, and the first that does something ends the turn. The climb ends where none does.

``sequence`` has the steps in their order. They are in ``subset_steps`` (sets of effects),
``exchange_steps`` (one effect for another), ``noise_steps`` (noise effects) and ``law_steps`` (laws
without a name, of which ``in_place`` has those that take the place of others); ``candidates`` is
what a turn scans, ``state`` what the steps hand on.
"""
