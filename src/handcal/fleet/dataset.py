"""The result as Parquet: ``data/recordings``, one row a recording, and ``data/parameters``, one row
a parameter of one, both partitioned by model (``model=NAME/part-0.parquet``)."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import quote

from handcal.fleet.record import Document, Source
from handcal.types import HandcalError, InputError

SCHEMA = "handcal/fleet-data/1"
FOLDER = "data"
RECORDINGS, PARAMETERS = "recordings", "parameters"
UNKNOWN = "unknown"
# Rows that are held before they are written: about a megabyte of parameters.
BATCH = 5000
# Column, type, what it is; the page docs/fleet.md has the same table.
COLUMNS: Mapping[str, tuple[tuple[str, str, str], ...]] = {
    RECORDINGS: (
        ("key", "string", "of its JSON in recordings/ and explanations/; empty: never read"),
        ("path", "string", "as it was read; an address without password and what follows a ?"),
        ("sha256", "string", "of its bytes"),
        ("device", "string", "as the manifest says; empty: not known"),
        ("started", "string", "ISO 8601, of the manifest or of the recording"),
        ("status", "string", "done, failed, timed_out, out_of_memory, unreachable, killed, "
         "crashed"),
        ("reason", "string", "why there is no result, in a sentence"),
        ("verdict", "string", "of explain"),
        ("named", "list", "ids of the effects that explain named"),
        ("unnamed", "list", "formulas of what has no name"),
        ("seconds", "double", "it took"),
        ("peak_bytes", "int64", "of memory"),
        ("duration_s", "double", "of the recording"),
        ("imu_rate_hz", "double", "of the IMU"),
        ("temperature_degC", "double", "mean"),
        ("gravity", "double", "median of what the accelerometer reads, m/s^2"),
        ("score_before", "double", "of what was not seen, without what was found, nats"),
        ("score_after", "double", "the same with it, nats"),
        ("priors", "string", "sha256 of the file of priors; empty: the catalogue's"),
        ("version", "string", "of handcal"),
    ),
    PARAMETERS: (
        ("key", "string", "of the recording"),
        ("device", "string", "as in recordings"),
        ("started", "string", "as in recordings"),
        ("effect", "string", "id in the catalogue"),
        ("name", "string", "of the parameter"),
        ("value", "double", "what the recording alone says, SI; of `named` what explain does"),
        ("sigma", "double", "of it, SI"),
        ("unit", "string", "SI"),
        ("prior_sigma", "double", "of the catalogue, SI; empty for `named`"),
        ("basis", "string", "together: in the model of every recording; beside: one at a time "
         "beside these; named: of the explanation, so only of what came out large"),
        ("probability", "double", "that the effect is present, as far as explain says"),
    ),
}  # fmt: skip


def write(folder: Path, rows: Iterable[tuple[Source, Document]]) -> None:
    """Both data sets, which take the place of older ones when they are complete. Errors: InputError
    without pyarrow, HandcalError where they cannot be written."""
    new, old, place = (folder / f"{FOLDER}{end}" for end in (".part", ".old", ""))
    try:
        for left in (new, old):
            shutil.rmtree(left, ignore_errors=True)
        with ExitStack() as open_files:
            writers = _Writers(new, open_files)
            for source, record in rows:
                model = source.model or UNKNOWN
                writers.add(RECORDINGS, model, [_recording(source, record)])
                writers.add(PARAMETERS, model, parameters(source, record))
            writers.flush()
        if new.exists():
            if place.exists():
                place.rename(old)
            new.rename(place)
            shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise HandcalError(f"{place} could not be written: {error.strerror or error}.") from error


class _Writers:
    """Files by data set and model, and the rows that wait for them."""

    def __init__(self, folder: Path, open_files: ExitStack) -> None:
        self.folder, self.open_files = folder, open_files
        self.arrow = _pyarrow()
        self.files: dict[tuple[str, str], Any] = {}
        self.waiting: dict[tuple[str, str], list[Document]] = {}

    def add(self, kind: str, model: str, rows: list[Document]) -> None:
        """More rows; the file is there even where there are none."""
        rows_there = self.waiting.setdefault((kind, model), [])
        rows_there += rows
        if len(rows_there) >= BATCH:
            self._write(kind, model)

    def flush(self) -> None:
        """Write what waits."""
        for kind, model in self.waiting:
            self._write(kind, model)

    def _write(self, kind: str, model: str) -> None:
        from pyarrow import parquet

        schema = arrow_schema(self.arrow, kind)
        if (kind, model) not in self.files:
            path = self.folder / kind / f"model={quote(model, safe='')}" / "part-0.parquet"
            path.parent.mkdir(parents=True)
            writer = self.open_files.enter_context(parquet.ParquetWriter(path, schema))
            self.files[kind, model] = writer
        table = self.arrow.Table.from_pylist(self.waiting[kind, model], schema)
        self.files[kind, model].write_table(table)
        self.waiting[kind, model].clear()


def arrow_schema(arrow: ModuleType, kind: str) -> Any:
    """Of the files of one kind, with our name and version in the metadata."""
    types = {"string": arrow.string(), "double": arrow.float64(), "int64": arrow.int64(),
             "list": arrow.list_(arrow.string())}  # fmt: skip
    fields = [
        arrow.field(name, types[kind], metadata={"description": said})
        for name, kind, said in COLUMNS[kind]
    ]
    return arrow.schema(fields, metadata={"handcal.schema": f"{SCHEMA}/{kind}"})


def _pyarrow() -> ModuleType:
    try:
        import pyarrow
    except ImportError:
        raise InputError("fleet needs pyarrow: pip install pyarrow.") from None
    module: ModuleType = pyarrow
    return module


def _recording(source: Source, r: Document) -> Document:
    about, scores = r.get("recording") or {}, r.get("held_out") or {}
    return {
        "key": r.get("key", ""), "path": source.shown, "sha256": r.get("sha256", ""),
        "device": source.device, "started": source.started, "status": r["status"],
        "reason": r["reason"], "verdict": r.get("verdict"),
        "named": [m["effect"] for m in r.get("named", [])], "unnamed": r.get("unnamed", []),
        "seconds": r.get("seconds"), "peak_bytes": r.get("peak"),
        "duration_s": about.get("duration_s"), "imu_rate_hz": about.get("imu_rate_hz"),
        "temperature_degC": about.get("temperature_degC"), "gravity": r.get("gravity"),
        "score_before": scores.get("log_score_before"),
        "score_after": scores.get("log_score_after"),
        "priors": (r.get("priors") or {}).get("sha256", ""), "version": r.get("version", ""),
    }  # fmt: skip


def parameters(source: Source, r: Document) -> list[Document]:
    """The rows of one recording's parameters."""
    return list(_parameters({"key": r.get("key", ""), "device": source.device,
                             "started": source.started}, r))  # fmt: skip


def _parameters(about: Document, r: Document) -> Iterator[Document]:
    likely = {h["effect"]: h["probability"] for h in r.get("hypotheses", [])}
    likely |= {m["effect"]: m["probability"] for m in r.get("named", [])}
    for t in r.get("told", []):
        own = {k: t[k] for k in ("effect", "name", "value", "sigma", "unit", "prior_sigma")}
        basis = "together" if t["together"] else "beside"
        yield about | own | {"basis": basis, "probability": likely.get(t["effect"])}
    for m in r.get("named", []):
        for p in m["parameters"]:
            yield about | p | {"effect": m["effect"], "prior_sigma": None, "basis": "named",
                               "probability": m["probability"]}  # fmt: skip
