"""What has no name: laws over a driver, courses over time or direction, errors that go with the
motion; drawn as curves, written out as formulas and as effect files.

Reading order: ``drivers``, ``grammar``, ``law_effect``, ``best_law`` (the best of hundreds beside a
model), ``with_motion``, ``curve``, ``law_file``; ``of_devices`` (the same laws for every recording
of a fleet).
"""
