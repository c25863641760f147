"""The mcap library: every message of a file, not decoded, and with checksums verified.

python mcap_messages.py FILE.mcap
"""

from __future__ import annotations

import sys
from pathlib import Path

from _serve import missing, serve

try:
    from mcap.reader import make_reader
except ImportError:
    missing("mcap")


def main() -> None:
    path = Path(sys.argv[1])

    def work() -> int:
        with path.open("rb") as file:
            return sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())

    serve("mcap", work)


if __name__ == "__main__":
    main()
