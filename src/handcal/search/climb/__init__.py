"""The climb, a greedy search by steps that raise the score: scan, take a step, fit again.

Each step is one function. It returns a better model, or None. The first step that returns a model
ends the turn. The climb ends with a turn in which no step does.

``sequence`` has the order of the steps. They are in ``subset_steps`` (sets of effects),
``exchange_steps`` (one effect for another), ``noise_steps`` (noise effects) and ``law_steps`` (laws
without a name; ``in_place`` has laws that replace other effects). ``candidates`` has the effects of
a scan, ``state`` the state that steps share.
"""
