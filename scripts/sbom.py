"""Write the software bill of materials: handcal and all that `pip install` brings with it, of the
versions of this environment, as CycloneDX 1.6. `make dist` runs it; argument: the folder."""

from __future__ import annotations

import json
import sys
import uuid
from importlib.metadata import distribution
from pathlib import Path

from dependencies import Package, closure, direct, licence, plain

SPEC = "1.6"


def _component(kind: str, p: Package) -> dict[str, object]:
    stated = {"expression": p.licence} if p.spdx else {"license": {"name": p.licence}}
    return {"type": kind, "bom-ref": _ref(p), "name": p.name, "version": p.version,
            "licenses": [stated], "purl": _ref(p)}  # fmt: skip


def _ref(p: Package) -> str:
    return f"pkg:pypi/{plain(p.name)}@{p.version.replace('+', '%2B')}"


def document() -> dict[str, object]:
    """The bill; equal for equal versions."""
    own = distribution("handcal")
    needs = tuple(direct(own))
    handcal = Package("handcal", own.version, *licence(own), needs)
    found = closure(needs)
    ways = [{"ref": _ref(p), "dependsOn": sorted(_ref(found[n]) for n in p.needs)}
            for p in (handcal, *found.values())]  # fmt: skip
    parts = [_component("library", p) for p in found.values()]
    number = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps([_ref(handcal), parts]))
    return {
        "$schema": f"http://cyclonedx.org/schema/bom-{SPEC}.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": SPEC,
        "serialNumber": f"urn:uuid:{number}",
        "version": 1,
        "metadata": {"component": _component("application", handcal)},
        "components": parts,
        "dependencies": ways,
    }


def main() -> None:
    """Write handcal-VERSION.cdx.json into the folder."""
    bill = document()
    place = Path(sys.argv[1]) / f"handcal-{distribution('handcal').version}.cdx.json"
    place.write_text(json.dumps(bill, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    print(place)


if __name__ == "__main__":
    main()
