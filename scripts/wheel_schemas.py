"""Puts the JSON Schema of every kind of result into the wheel (`handcal/schemas/calibrate.json` and
so on), made from its type; pyproject.toml has hatchling run it."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Schemas(BuildHookInterface):  # type: ignore[type-arg]
    """An editable install has the function alone: ``handcal.results.schemas``."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            return
        sys.path[:0] = [f"{self.root}/src", f"{self.root}/sim"]
        import handcal.results
        import handcal_sim.results

        self.folder = tempfile.TemporaryDirectory()
        for package in (handcal, handcal_sim):
            for name, schema in package.results.schemas().items():
                file = Path(self.folder.name) / f"{name}.json"
                file.write_text(json.dumps(schema, indent=2, ensure_ascii=False), "utf-8")
                inside = f"{package.__name__}/schemas/{name}.json"
                build_data["force_include"][str(file)] = inside

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:  # noqa: ARG002
        if version != "editable":
            self.folder.cleanup()
