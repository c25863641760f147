"""Laboratory methods on the same catalogue of effects: known inputs, the gravity norm, and more.

A file ``<name>_command.py`` in this folder is the command ``handcal lab <name>``: it defines a
function of that name (``-`` in the command is ``_`` in Python); nothing else needs to know of it.
"""
