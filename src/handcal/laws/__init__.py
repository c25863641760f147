"""What has no name: laws over a driver, courses over time or direction, errors that go with the
motion; drawn as curves, written out as formulas and as effect files.

Reading order: ``drivers`` and ``operators`` (what may drive an error), ``vocabulary`` and
``compositions`` (which drivers are looked at), ``grammar`` (the forms of a law), ``law_effect`` (a
law as an effect); ``terms`` (laws of a heading), ``courses`` and ``shapes`` (over time or
direction); ``weighing``, ``short_windows`` and ``over_drivers`` (the best of thousands beside a
model); ``law_constants``, ``course_numbers`` (their numbers about a fit); ``with_motion`` (errors
without a law); ``curve`` (drawn), ``law_code``, ``driver_code``, ``law_file`` (written out);
``of_devices`` (the same laws for every recording of a fleet).
"""
