"""What the environment that runs this weighs, by package; exit status 1 beyond --most MB."""

from __future__ import annotations

import argparse
import sys
import sysconfig
from collections import Counter
from importlib.metadata import distributions
from pathlib import Path

# Not counted: the viewer and what it brings to read tables, and what makes environments.
APART = ("rerun-sdk", "pyarrow", "pip", "setuptools")
LEAST_MB = 1.0  # of a package, to be named


def weighed(folder: Path) -> Counter[str]:
    """Bytes below a folder of packages, by name of the package; what was compiled in use counts
    where it lies."""
    owner = {}
    for one in distributions(path=[str(folder)]):
        for file in one.files or ():
            if file.parts[0] != "..":
                owner.setdefault(file.parts[0], one.name)
    out: Counter[str] = Counter()
    for path in folder.rglob("*"):
        if path.is_file() and not path.is_symlink():
            top = path.relative_to(folder).parts[0]
            out[owner.get(top, top)] += path.stat().st_size
    return out


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=float, default=float("inf"), metavar="MB")
    most = parser.parse_args().most
    sizes = weighed(Path(sysconfig.get_path("purelib")))
    for name, size in sizes.most_common():
        if size / 1e6 >= LEAST_MB:
            print(f"{size / 1e6:8.1f}  {name}")
    counted = sum(size for name, size in sizes.items() if name not in APART) / 1e6
    print(f"{counted:8.1f}  MB in all, besides {', '.join(APART)}")
    if counted > most:
        print(f"More than the {most:g} MB that it may be.", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
