"""The ``handcal`` command, also ``python -m handcal``: what ends it is heard before it imports."""

import atexit

from handcal.commands import _ending


def main() -> None:
    """The ``handcal`` command. Leaves by SystemExit."""
    _ending.listen(_ending.at_once)
    atexit.register(_ending.over)  # (first, to be last)
    from handcal.commands import _app

    try:
        _app.main()  # (which listens for itself, as files may be half written)
    finally:
        _ending.listen(_ending.at_once)


if __name__ == "__main__":
    main()
