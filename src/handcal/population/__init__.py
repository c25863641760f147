"""What the devices of one kind have in common, from what each recording says with its own sigma.

Plain statistics of values (n,), sigmas (n,) and whose they are; nothing here knows a recording.
Reading order: ``grouped`` (recordings to devices), ``deconvolved`` (mean, spread and tail of the
true errors), ``stacked`` (evidence summed over devices), ``joint`` (all parameters at once),
``odd`` (whom the population does not expect), ``drift`` (what changes from one recording to the
next), ``laws`` (what is common and has no name), and ``by_model``: all of it, of every parameter.
"""
