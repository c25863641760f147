"""What handcal's dependencies are and under which licence, from the metadata of the environment."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement

LONGEST = 80  # characters of a licence's name; what is longer is its text


@dataclass(frozen=True)
class Package:
    """An installed package; spdx: its licence is stated as an SPDX expression."""

    name: str
    version: str
    licence: str
    spdx: bool
    needs: tuple[str, ...]


def plain(name: str) -> str:
    """The name as package indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def direct(of: Distribution, extra: str = "") -> list[str]:
    """Plain names that a package requires on this system, of an extra those that it adds."""
    found = []
    for text in of.requires or []:
        r = Requirement(text)
        usual = r.marker is None or r.marker.evaluate({"extra": ""})
        if (not usual and r.marker.evaluate({"extra": extra})) if extra else usual:
            found.append(plain(r.name))
    return sorted(set(found))


def extras(of: Distribution) -> list[str]:
    """The names of its extras."""
    return list(of.metadata.get_all("Provides-Extra") or [])


def licence(of: Distribution) -> tuple[str, bool]:
    """What it is licensed under, and whether that is an SPDX expression."""
    if expression := of.metadata.get("License-Expression"):
        return expression, True
    lines = [line.strip() for line in (of.metadata.get("License") or "").strip().splitlines()]
    if len(lines) == 1 and lines[0] != "UNKNOWN" and len(lines[0]) < LONGEST:
        return lines[0], False
    classifiers = of.metadata.get_all("Classifier") or []
    named = [c.split(" :: ")[-1] for c in classifiers if c.startswith("License ::")]
    return " or ".join(named) or next((line for line in lines if line), "not stated"), False


def package(name: str) -> Package | None:
    """The installed package, None where there is none of that name."""
    try:
        found = distribution(name)
    except PackageNotFoundError:
        return None
    return Package(found.metadata["Name"], found.version, *licence(found), tuple(direct(found)))


def closure(names: Iterable[str]) -> dict[str, Package]:
    """The packages and all that they need, by plain name, sorted. Errors: LookupError where one is
    not installed."""
    found: dict[str, Package] = {}
    todo = list(names)
    while todo:
        name = todo.pop()
        if name not in found:
            one = package(name)
            if one is None:
                raise LookupError(f"{name} is not installed here.")
            found[name] = one
            todo += one.needs
    return dict(sorted(found.items()))
