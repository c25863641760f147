"""What one calls from Python. ``import handcal`` has all of it; ``help(handcal)`` the conventions.

Every function takes recordings, or paths of files, or several of either; every result is what the
rest of the program works on, with a table that a notebook shows, ``plot`` and ``report``.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np

from handcal import output
from handcal.explain import verdict
from handcal.explain.explanation import Explanation as ExplanationData
from handcal.recordings import inputs
from handcal.recordings.streams import STREAMS
from handcal.types import Array, HandcalError, InputError, Parameter, Result
from handcal.types import Recording as RecordingData

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from handcal.device import apply as device

Progress = Callable[[float], None]
COLUMNS = ("effect", "name", "value", "sigma", "unit", "observable")


class Recording(RecordingData):
    """A recording. ``imu`` has t (n,) s, gyro (n, 3) rad/s and accel (n, 3) m/s^2; ``streams`` what
    else was measured, by name; SI, in the conventions of ``help(handcal)``."""

    @classmethod
    def from_arrays(
        cls,
        t: Array,
        gyro: Array,
        accel: Array,
        *,
        name: str = "arrays",
        **streams: tuple[Array, Array],
    ) -> Self:
        """Of arrays: t (n,) s, gyro (n, 3) rad/s, accel (n, 3) m/s^2, specific force.

        streams: of each a pair (t (m,) s on the same clock, values (m, d)): heading rad; mag
        (m, 3) tesla; temperature degC; pose (m, 7) position in m and quaternion w x y z of the
        marker's axes; reference (m, 6) rad/s and m/s^2. Repaired and checked as files are: what
        was done is in ``warnings``. Errors: InputError.
        """
        for stream in streams:
            if stream not in STREAMS or stream == "imu":
                known = ", ".join(s for s in STREAMS if s != "imu")
                raise InputError(f"There is no stream '{stream}'; there are {known}.")
        read = inputs.of_arrays(
            name,
            t,
            gyro,
            accel,
            {s: (pair, len(STREAMS[s].columns)) for s, pair in streams.items()},
        )
        return cls.of(read)

    @classmethod
    def of(cls, recording: RecordingData) -> Self:
        """The same recording, with this class's ways."""
        return cls(**_values(recording))

    def write(self, path: str | Path) -> None:
        """Write it as MCAP. Errors: InputError where that is the file it was read from."""
        from handcal.recordings.export import write_mcap

        output.check_outputs((Path(path),), (Path(self.path),))
        write_mcap(self, path)

    def __repr__(self) -> str:
        name, streams = Path(self.path).name, ", ".join(["imu", *self.streams])
        said = f"{self.duration_s:.1f} s at {self.rate_hz:.0f} Hz, {streams}"
        warned = f", {len(self.warnings)} warnings" if self.warnings else ""
        return f"Recording({name}: {said}{warned})"

    def _repr_html_(self) -> str:
        return f"<code>{html.escape(repr(self))}</code>"


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
        try:
            import pandas
        except ImportError:
            raise HandcalError(
                "pandas is not installed: `pip install pandas`, or use .values and .sigmas."
            ) from None
        rows = [[getattr(p, column) for column in COLUMNS] for p in self]
        return pandas.DataFrame(rows, columns=list(COLUMNS))

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
        rows = [("parameter", "value", "± 1 sigma", "unit"), *self._rows()]
        width = [max(len(row[k]) for row in rows) for k in range(4)]
        lines = (
            f"{a:<{width[0]}}  {b:>{width[1]}}  {c:>{width[2]}}  {d}".rstrip()
            for a, b, c, d in rows
        )
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return _html(("parameter", "value", "± 1 sigma", "unit"), self._rows())


class Calibration(Result):
    """What ``calibrate`` learnt from one recording: ``parameters`` with their ``covariance``,
    ``noise``, ``innovations``, ``history`` and ``smoothed``, ``log_evidence``, ``warnings``."""

    parameters: Parameters

    @classmethod
    def of(cls, result: Result) -> Self:
        """The same result, with this class's ways."""
        values = _values(result)
        return cls(**values | {"parameters": Parameters(values["parameters"])})

    def plot(self) -> Figure:
        """The parameters with one and three sigma, each in what is usual for such a device."""
        from handcal.show.calibration.plots import sizes

        return sizes(self.parameters)

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

    @property
    def document(self) -> Mapping[str, Any]:
        """What ``handcal calibrate --json`` writes."""
        from handcal.show.calibration.summary import calibration_json, stamped

        return stamped(calibration_json(self))

    def __repr__(self) -> str:
        from handcal.show import words

        judged = words.verdict(self)
        name = Path(self.recording.path).name
        return f"Calibration of {name}: {judged.headline}\n{self.parameters!r}"

    def _repr_html_(self) -> str:
        from handcal.show import words

        judged = words.verdict(self)
        said = "".join(f"<p>{html.escape(s)}</p>" for s in (judged.headline, *judged.sentences))
        return said + self.parameters._repr_html_()


class Explanation(ExplanationData):
    """What ``explain`` says: ``verdict``, ``missing`` (effects with their parameters and
    probability), ``unnamed`` (laws), ``hypotheses``, ``parameters``, ``warnings``."""

    parameters: Parameters

    @classmethod
    def of(cls, explanation: ExplanationData) -> Self:
        """The same explanation, with this class's ways."""
        values = _values(explanation)
        return cls(**values | {"parameters": Parameters(values["parameters"])})

    def plot(self) -> Figure:
        """What is missing with one and three sigma, each in what is usual for such a device; the
        biases where nothing is."""
        from handcal.show.calibration.plots import sizes

        found = [p for m in self.missing for p in m.parameters]
        return sizes(found or self.parameters)

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

    @property
    def document(self) -> Mapping[str, Any]:
        """What ``handcal explain --json`` writes."""
        from handcal.show.calibration.summary import stamped
        from handcal.show.explanation.summary import explanation_json

        return stamped(explanation_json(self))

    @property
    def _paths(self) -> list[Path]:
        return [Path(r.recording.path) for r in self.recordings]

    def _found(self) -> list[tuple[str, str, str]]:
        from handcal.show.explanation import words

        rows = [(m.title, m.probability, m.log_evidence_gain) for m in self.missing]
        out = [(title, words.percent(p), words.nats(gain)) for title, p, gain in rows]
        return [*out, *((u.formula, "", words.nats(u.log_evidence_gain)) for u in self.unnamed)]

    def __repr__(self) -> str:
        from handcal.show.explanation import sentences

        lines = [f"Explanation ({self.verdict}): {sentences.verdict(self).headline}"]
        lines += [f"  {a}  {c}" + (f", {b}" if b else "") for a, b, c in self._found()]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        from handcal.show.explanation import sentences

        said = f"<p>{html.escape(sentences.verdict(self).headline)}</p>"
        found = self._found()
        table = _html(("missing", "probability", "gain"), found) if found else ""
        return said + table + self.parameters._repr_html_()


@dataclass(frozen=True, repr=False)
class Corrected:
    """A recording without the errors that were learnt; taken: ids of what was taken off; left:
    other ids, by reason."""

    recording: Recording
    taken: tuple[str, ...]
    left: Mapping[str, tuple[str, ...]]

    def write(self, path: str | Path) -> None:
        """Write the recording as MCAP."""
        self.recording.write(path)

    def __repr__(self) -> str:
        left = "".join(f"; left: {', '.join(ids)} ({why})" for why, ids in self.left.items())
        return f"Corrected({self.recording!r}, without {', '.join(self.taken) or 'anything'}{left})"


Source = RecordingData | str | Path


def read(
    path: str | Path,
    *,
    topics: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Recording:
    """A recording from a file of any format that the command line reads.

    topics: which MCAP topic is which stream ({"imu": "/phone/imu"}). units: where they are not as
    the format states ({"accel": "g"}). Errors: InputError.
    """
    return Recording.of(inputs.load(path, topics=topics, units=units))


@overload
def calibrate(
    recording: Source, effects: Sequence[str] | str = (), **options: Any
) -> Calibration: ...
@overload
def calibrate(
    recording: Sequence[Source], effects: Sequence[str] | str = (), **options: Any
) -> tuple[Calibration, ...]: ...
def calibrate(
    recording: Source | Sequence[Source], effects: Sequence[str] | str = (), **options: Any
) -> Calibration | tuple[Calibration, ...]:
    """Sensor errors of a device from a recording, or from several together, and how well they are
    known.

    effects: ids of the catalogue beyond constant biases ("gyro_scale"). options: assume ("auto",
    "fixed-point", "rest-only"), heading_sigma (rad), latitude (rad), height (m), ignore (streams),
    observations, noise, noise_until (s), engine, reference_exact, progress. Of several recordings
    one result each: the effects are told by all of them together. Errors: InputError,
    HandcalError.
    """
    from handcal.estimate.calibration import calibrate_together

    recordings = _recordings(recording, "calibrate")
    wanted = [e.strip() for e in effects.split(",")] if isinstance(effects, str) else list(effects)
    done = calibrate_together(recordings, [e for e in wanted if e], **options)
    results = tuple(Calibration.of(r) for r in done)
    return results[0] if isinstance(recording, RecordingData | str | Path) else results


def explain(
    recording: Source | Sequence[Source],
    held_out: Source | Sequence[Source] = (),
    **options: Any,
) -> Explanation:
    """Which physics a recording of a device, or several together, hold beyond constant biases:
    where, which, how certain.

    held_out: other recordings of the device, for scoring alone. options: as of ``calibrate``,
    without engine, observations and noise. Errors: InputError, HandcalError.
    """
    others = _recordings(held_out, "explain") if held_out else []
    return Explanation.of(verdict.explain(_recordings(recording, "explain"), others, **options))


def conceal(recording: Source, effects: Mapping[str, Sequence[float]], seed: int = 0) -> Recording:
    """The recording as a device with further errors would have made it: {"gyro_scale": [0.01, 0,
    0]}, values in the order of the catalogue's parameters, SI. Errors: InputError, HandcalError."""
    from handcal.device import conceal as device

    (one,) = _recordings(recording, "conceal")
    rng = np.random.default_rng(seed)
    return Recording.of(device.conceal(one, effects, rng))


def apply(
    recording: Source, learnt: Result | ExplanationData | str | Path, *, biases: bool = False
) -> Corrected:
    """A recording of the device without the errors that were learnt, for any other program.

    learnt: a calibration or an explanation, or the path of its JSON. biases: take off also what
    differs from day to day. Errors: InputError, HandcalError.
    """
    from handcal.device import apply as device

    (one,) = _recordings(recording, "apply")
    done = device.apply(one, _learnt(learnt), biases=biases)
    return Corrected(Recording.of(done.recording), done.taken, done.left)


def _learnt(learnt: Result | ExplanationData | str | Path) -> device.Learnt:
    from handcal.device import apply as device

    if isinstance(learnt, str | Path):
        return device.read(Path(learnt))
    if isinstance(learnt, Result):
        return device.of_document("this calibration", Calibration.of(learnt).document)
    if isinstance(learnt, ExplanationData):
        return device.of_document("this explanation", Explanation.of(learnt).document)
    raise InputError(
        "apply takes what was learnt second: a calibration, an explanation, or the path of its "
        f"JSON, no {type(learnt).__name__}."
    )


def _recordings(given: Source | Sequence[Source], caller: str) -> list[RecordingData]:
    """One or several recordings or paths as recordings. Errors: InputError."""
    several = [given] if isinstance(given, RecordingData | str | Path) else given
    if isinstance(several, list | tuple):
        if all(isinstance(one, RecordingData | str | Path) for one in several):
            return [one if isinstance(one, RecordingData) else read(one) for one in several]
        given = next(x for x in several if not isinstance(x, RecordingData | str | Path))
    raise InputError(
        f"{caller} takes recordings or paths of files, no {type(given).__name__}; of arrays make "
        "one by handcal.Recording.from_arrays(t, gyro, accel)."
    )


def _values(one: Any) -> dict[str, Any]:
    return {f.name: getattr(one, f.name) for f in fields(one)}


def _html(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(c)}</th>" for c in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
