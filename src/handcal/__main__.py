"""``python -m handcal`` is the ``handcal`` command."""

from handcal.commands._app import main

main()
