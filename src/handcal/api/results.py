"""What ``calibrate``, ``explain`` and ``apply`` give back: results that show themselves as a table,
draw themselves, and write themselves to files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np

from handcal import output
from handcal.api import tables
from handcal.api.recording import Recording, values_of
from handcal.api.words import in_python
from handcal.explanation import Explanation as ExplanationData
from handcal.trust import Trust, said
from handcal.types import Array, Parameter, Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


COLUMNS = ("effect", "name", "value", "sigma", "unit", "shown")
_SHOWN = ("parameter", "value", "± 1 sigma", "unit")


class Parameters(tuple[Parameter, ...]):
    """Estimated numbers, in order. ``p["gyro_scale"]`` are those of an effect, ``p["gyro_scale",
    "x"]`` is one of them."""

    @overload  # type: ignore[override]
    def __getitem__(self, key: str) -> Parameters: ...
    @overload
    def __getitem__(self, key: slice) -> Parameters: ...
    @overload
    def __getitem__(self, key: int | tuple[str, str]) -> Parameter: ...
    def __getitem__(self, key: int | slice | str | tuple[str, str]) -> Parameter | Parameters:
        if isinstance(key, str):
            own = Parameters(p for p in self if p.effect == key)
            if not own:
                known = ", ".join(dict.fromkeys(p.effect for p in self))
                raise KeyError(f"{key} was not estimated; {known} were.")
            return own
        if isinstance(key, tuple):
            effect, name = key
            own = self[effect]
            found = [p for p in own if p.name == name]
            if not found:
                raise KeyError(f"{effect} has {', '.join(p.name for p in own)}, but no {name}.")
            return found[0]
        found_ = super().__getitem__(key)
        return Parameters(found_) if isinstance(key, slice) else found_  # type: ignore[arg-type, return-value]

    @property
    def values(self) -> Array:
        """(m,) SI."""
        return np.array([p.value for p in self])

    @property
    def sigmas(self) -> Array:
        """(m,) one standard deviation, SI."""
        return np.array([p.sigma for p in self])

    def to_pandas(self) -> Any:
        """A pandas.DataFrame, SI. Errors: HandcalError where pandas is not installed."""
        rows = [[getattr(p, column) for column in COLUMNS] for p in self]
        return tables.frame(COLUMNS, rows, "use .values and .sigmas")

    def _rows(self) -> list[tuple[str, str, str, str]]:
        from handcal.show import words

        rows = []
        for group in words.by_effect(self).values():
            unit = words.shown_group(group)
            for p in group:
                value = unit.value(p.value, p.sigma, sign=True)
                rows.append(
                    (words.parameter_title(p), value, unit.value(p.sigma, p.sigma), unit.unit)
                )
        return rows

    def __repr__(self) -> str:
        return tables.text(_SHOWN, self._rows(), right=(1, 2))

    def _repr_html_(self) -> str:
        return tables.html_table(_SHOWN, self._rows())


def _in_front(parameters: Parameters, found: Iterable[str] = ()) -> tuple[Parameters, list[str]]:
    """Those that a table shows, and what is said below it; found: ids of effects."""
    from handcal.show.calibration.shown import in_front, under_table

    front, rest = in_front(parameters, found)
    return Parameters(front), under_table(front, rest)


class Doubted:
    """What says of itself how far it is to be trusted."""

    @property
    def _trust(self) -> Trust:
        raise NotImplementedError

    @property
    def trust(self) -> str:
        """ "good", "doubtful" or "none"."""
        return self._trust.level

    @property
    def trust_reasons(self) -> tuple[str, ...]:
        """Why it is not "good", in sentences."""
        return tuple(map(in_python, self._trust.reasons))


class Calibration(Doubted, Result):
    """What ``calibrate`` learnt from one recording: ``parameters`` with their ``covariance``,
    ``noise``, ``innovations``, ``history`` and ``smoothed``, ``log_evidence``, ``warnings``."""

    parameters: Parameters

    @classmethod
    def of(cls, result: Result) -> Self:
        """The same result, with this class's ways."""
        values = values_of(result)
        return cls(**values | {"parameters": Parameters(values["parameters"])})

    def plot(self) -> Figure:
        """The parameters that are shown, with one and three sigma, each in what is usual for such a
        device."""
        from handcal.show.calibration.plots import sizes
        from handcal.show.calibration.shown import drawn

        return sizes(drawn(self.parameters))

    def report(self, path: str | Path) -> None:
        """Write the page of ``handcal calibrate --report``."""
        from handcal.show.calibration.report import write_report

        output.check_outputs((Path(path),), (Path(self.recording.path),))
        write_report(self, path)

    def save(self, path: str | Path) -> None:
        """Write what ``handcal calibrate --json`` writes."""
        from handcal.show.calibration.summary import write_json

        output.check_outputs((Path(path),), (Path(self.recording.path),))
        write_json(self.document, path)

    def rrd(self, path: str | Path) -> None:
        """Write the file for Rerun's viewer of ``handcal calibrate --rrd``."""
        from handcal.show.dashboard import save_rrd

        output.check_outputs((Path(path),), (Path(self.recording.path),))
        save_rrd(self, Path(path))

    @property
    def document(self) -> Mapping[str, Any]:
        """What ``handcal calibrate --json`` writes."""
        from handcal.show.calibration.summary import calibration_json, stamped

        return stamped(calibration_json(self))

    @property
    def _trust(self) -> Trust:
        from handcal.show.doubts import of_calibration

        return of_calibration(self)

    def __repr__(self) -> str:
        from handcal.show.calibration import how_good, verdict_text

        judged = verdict_text.verdict(self)
        name = Path(self.recording.path).name
        good = how_good.sentences(self.parameters, self.covariance, self.before)
        table, below = _in_front(self.parameters)
        head = f"Calibration of {name}: {judged.headline}"
        doubts = said("This calibration", replace(self._trust, reasons=self.trust_reasons))
        return "\n".join([head, *good, repr(table), *below, *doubts])

    def _repr_html_(self) -> str:
        from handcal.show.calibration import verdict_text

        judged = verdict_text.verdict(self)
        doubts = said("This calibration", self._trust)
        sentences = (judged.headline, *judged.sentences, *doubts)
        text = tables.paragraphs(map(in_python, sentences))
        table, below = _in_front(self.parameters)
        return text + table._repr_html_() + tables.paragraphs(below)


class Explanation(Doubted, ExplanationData):
    """What ``explain`` says: ``verdict``, ``missing`` (effects with their parameters and
    probability), ``unnamed`` (laws), ``hypotheses``, ``parameters``, ``warnings``."""

    parameters: Parameters

    @classmethod
    def of(cls, explanation: ExplanationData) -> Self:
        """The same explanation, with this class's ways."""
        values = values_of(explanation)
        return cls(**values | {"parameters": Parameters(values["parameters"])})

    def plot(self) -> Figure:
        """What was found with one and three sigma, each in what is usual for such a device; what is
        shown where nothing was."""
        from handcal.show.calibration.plots import sizes
        from handcal.show.calibration.shown import drawn

        found = [p for m in self.missing for p in m.parameters]
        return sizes(found or drawn(self.parameters))

    def report(self, path: str | Path) -> None:
        """Write the page of ``handcal explain --report``."""
        from handcal.show.explanation.report import write_explanation_report

        output.check_outputs((Path(path),), self._paths)
        write_explanation_report(self, path)

    def save(self, path: str | Path) -> None:
        """Write what ``handcal explain --json`` writes."""
        from handcal.show.calibration.summary import write_json

        output.check_outputs((Path(path),), self._paths)
        write_json(self.document, path)

    def rrd(self, path: str | Path) -> None:
        """Write the file for Rerun's viewer of ``handcal explain --rrd``."""
        from handcal.show.dashboard import save_explanation_rrd

        output.check_outputs((Path(path),), self._paths)
        save_explanation_rrd(self, Path(path))

    @property
    def document(self) -> Mapping[str, Any]:
        """What ``handcal explain --json`` writes."""
        from handcal.show.calibration.summary import stamped
        from handcal.show.explanation.document import explanation_json

        return stamped(explanation_json(self))

    @property
    def _trust(self) -> Trust:
        from handcal.show.doubts import of_explanation

        return of_explanation(self)

    @property
    def _paths(self) -> list[Path]:
        return [Path(r.recording.path) for r in self.recordings]

    def _found(self) -> list[tuple[str, str, str]]:
        from handcal.show.explanation import words

        rows = [(m.title, m.probability, m.log_evidence_gain) for m in self.missing]
        out = [(title, words.percent(p), words.nats(gain)) for title, p, gain in rows]
        return [*out, *((u.formula, "", words.nats(u.log_evidence_gain)) for u in self.unnamed)]

    def __repr__(self) -> str:
        from handcal.show.calibration import how_good
        from handcal.show.explanation import verdict_text

        lines = [f"Explanation ({self.verdict}): {verdict_text.verdict(self).headline}"]
        lines += how_good.sentences(self.parameters, self.covariance, self.device)
        lines += [
            f"  {a}{f', probability {b}' if b else ''} (removing it costs {c})"
            for a, b, c in self._found()
        ]
        lines += said("This explanation", replace(self._trust, reasons=self.trust_reasons))
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        from handcal.show.calibration import how_good
        from handcal.show.explanation import verdict_text

        good = how_good.sentences(self.parameters, self.covariance, self.device)
        doubts = said("This explanation", replace(self._trust, reasons=self.trust_reasons))
        text = tables.paragraphs([verdict_text.verdict(self).headline, *good, *doubts])
        found = self._found()
        table = (
            tables.html_table(("found", "probability", "removing it costs"), found) if found else ""
        )
        front, below = _in_front(self.parameters, [m.effect for m in self.missing])
        return text + table + front._repr_html_() + tables.paragraphs(below)


@dataclass(frozen=True, repr=False)
class Corrected:
    """A recording without the errors that were learnt; taken: ids of what was taken off; left:
    other ids, by reason; warnings: what there is to doubt about what was learnt, and whether it is
    of this device."""

    recording: Recording
    taken: tuple[str, ...]
    left: Mapping[str, tuple[str, ...]]
    warnings: tuple[str, ...] = ()

    def write(self, path: str | Path) -> None:
        """Write the recording as MCAP."""
        self.recording.write(path)

    def __repr__(self) -> str:
        left = "".join(
            f"; left: {', '.join(ids)} ({in_python(why)})" for why, ids in self.left.items()
        )
        text = f"Corrected({self.recording!r}, without {', '.join(self.taken) or 'anything'}{left})"
        return "\n".join([text, *self.warnings])
