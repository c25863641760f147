"""The command line: one file is one command.

A file ``NAME.py`` in this folder is the command ``handcal NAME`` and defines a
function of that name; a folder holds the commands of a command. Nothing else needs to know of it.
``_options`` is the table of options that commands share.
"""
