"""``python -m handcal`` is the ``handcal`` command."""

from handcal.cli import main

main()
