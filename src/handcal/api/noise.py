"""What ``allan`` gives back: the noise of a device at rest, as a table, a page or a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from handcal import output
from handcal.allan.analysis import Allan as AllanData
from handcal.api import tables
from handcal.api.recording import values_of
from handcal.api.words import in_python

COLUMNS = ("channel", "name", "value", "sigma", "unit")
_SHOWN = ("channel", "noise", "value", "± 1 sigma", "unit")


class Allan(AllanData):
    """Noise at rest: ``channels``, each with ``tau`` and ``deviation`` (``low``, ``high``: 95 %),
    and its ``terms`` N, B, K, Q, R; ``term("N")`` is one of them. ``suggested``: levels for the
    filter; ``span``, ``warnings``."""

    @classmethod
    def of(cls, result: AllanData) -> Self:
        """The same analysis, with this class's ways."""
        return cls(**values_of(result))

    def to_pandas(self) -> Any:
        """A pandas.DataFrame of the terms, SI. Errors: HandcalError without pandas."""
        rows = [[c.name, t.name, t.value, t.sigma, t.unit] for c in self.channels for t in c.terms]
        return tables.frame(COLUMNS, rows, "use .channels, of each .terms")

    def report(self, path: str | Path) -> None:
        """Write the page of ``handcal allan --report``."""
        from handcal.show.allan import write_allan_report

        output.check_outputs((Path(path),), (Path(self.recording.path),))
        write_allan_report(self, path)

    def save(self, path: str | Path) -> None:
        """Write what ``handcal allan --json`` writes."""
        from handcal.show.calibration.summary import write_json

        output.check_outputs((Path(path),), (Path(self.recording.path),))
        write_json(self.document, path)

    @property
    def document(self) -> Mapping[str, Any]:
        """What ``handcal allan --json`` writes."""
        from handcal.show.allan import allan_json
        from handcal.show.calibration.summary import stamped

        return stamped(allan_json(self))

    def __repr__(self) -> str:
        from handcal.show.allan import coefficients, used

        name = Path(self.recording.path).name
        table = tables.text(_SHOWN, coefficients(self), right=(2, 3))
        return "\n".join([f"Allan deviation of {name}: {used(self)}", table, *self._said()])

    def _repr_html_(self) -> str:
        from handcal.show.allan import coefficients, used

        return tables.paragraphs([used(self)]) + tables.html_table(
            _SHOWN, coefficients(self)
        ) + tables.paragraphs(self._said())  # fmt: skip

    def _said(self) -> list[str]:
        from handcal.show.allan import too_short

        return [*too_short(self), *map(in_python, self.warnings)]
