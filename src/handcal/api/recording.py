"""``handcal.Recording``: a recording that can be made of arrays and written to a file."""

from __future__ import annotations

import html
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Self

from handcal import output
from handcal.api.words import of_arrays, spoken
from handcal.did_you_mean import did_you_mean
from handcal.recordings import inputs
from handcal.recordings.streams import STREAMS
from handcal.types import Array, InputError
from handcal.types import Recording as RecordingData


class Recording(RecordingData):
    """A recording. ``imu`` has t (n,) s, gyro (n, 3) rad/s and accel (n, 3) m/s^2; ``streams`` what
    else was measured, by name; SI, in the conventions of ``help(handcal)``."""

    @classmethod
    def from_arrays(
        cls,
        t: Array,
        gyro: Array | None = None,
        accel: Array | None = None,
        *,
        name: str = "arrays",
        **streams: tuple[Array, Array],
    ) -> Self:
        """Of arrays, all three needed: t (n,) s, gyro (n, 3) rad/s, accel (n, 3) m/s^2, specific
        force.

        name: what results and reports call it, in place of a file's name. streams: of each a pair
        (t (m,) s on the same clock, values (m, d)): heading rad; mag (m, 3) tesla; temperature
        degC; pose (m, 7) position in m and quaternion w x y z of the marker's axes; reference
        (m, 6) rad/s and m/s^2. Repaired and checked as files are: what was done is in
        ``warnings``. Errors: InputError.
        """
        if isinstance(t, str | Path):
            raise InputError(
                f"from_arrays takes arrays; a file is read by handcal.read({str(t)!r})."
            )
        if gyro is None or accel is None:
            raise InputError("from_arrays takes three arrays at least: t, gyro and accel.")
        for stream in streams:
            if stream not in STREAMS or stream == "imu":
                known = [s for s in STREAMS if s != "imu"]
                meant = did_you_mean(stream, known)
                raise InputError(
                    f"There is no stream '{stream}'.{meant} There are: {', '.join(known)}."
                )
        further = {s: (pair, len(STREAMS[s].columns)) for s, pair in streams.items()}
        with spoken(arrays=True):
            read = inputs.of_arrays(name, t, gyro, accel, further)
        return cls.of(replace(read, warnings=tuple(map(of_arrays, read.warnings))))

    @classmethod
    def of(cls, recording: RecordingData) -> Self:
        """The same recording, with this class's ways."""
        return cls(**values_of(recording))

    def write(self, path: str | Path) -> None:
        """Write it as MCAP, *.mcap. Errors: InputError for another ending, and where that is the
        file it was read from."""
        from handcal.recordings.export import write_mcap

        if Path(path).suffix.lower() not in ("", ".mcap"):
            raise InputError(
                f"{path}: recordings are written as MCAP and in no other format; name it "
                f"{Path(path).with_suffix('.mcap').name}."
            )
        output.check_outputs((Path(path),), (Path(self.path),))
        write_mcap(self, path)

    def __repr__(self) -> str:
        name, streams = Path(self.path).name, ", ".join(["imu", *self.streams])
        said = f"{self.duration_s:.1f} s at {self.rate_hz:.0f} Hz, {streams}"
        warned = f", {len(self.warnings)} warnings" if self.warnings else ""
        return f"Recording({name}: {said}{warned})"

    def _repr_html_(self) -> str:
        return f"<code>{html.escape(repr(self))}</code>"


def values_of(one: Any) -> dict[str, Any]:
    """The fields of a dataclass, by name, as they are."""
    return {f.name: getattr(one, f.name) for f in fields(one)}
