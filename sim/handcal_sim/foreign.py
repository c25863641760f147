"""Effects that this simulator has not, put into its recording by a program that has them.

A file is all that passes between the two: ``handcal conceal`` reads the recording and writes
another; the truth, which it does not read, is put back beside it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from handcal_sim import mcap_writer
from handcal_sim.effects import parse_effect
from handcal_sim.errors import SimulationError
from handcal_sim.scenario import World

TRUTH, PARAMETERS = "/truth/", "/truth/parameters"


def write(
    world: World, path: str | Path, effects: Sequence[str], seed: int, folder: Path | None = None
) -> int:
    """As ``mcap_writer.write``, with these effects too, which /truth/parameters names "concealed".

    folder: of effect files that the other program has not either.

    Raises SimulationError with the other program's sentence where it cannot.
    """
    options = [part for effect in effects for part in ("--effect", effect)]
    if folder is not None:
        options += ["--effects-from", str(folder)]
    with TemporaryDirectory() as between:
        simulated, concealed = (Path(between) / f"{name}.mcap" for name in ("without", "with"))
        count = mcap_writer.write(world, simulated)
        done = subprocess.run(
            [sys.executable, "-m", "handcal", "conceal", str(simulated), *options,
             "--seed", str(seed), "-o", str(concealed)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            said = (done.stderr.strip().splitlines() or [""])[-1].removeprefix("handcal: ")
            if done.returncode != 2 or said.startswith("Unknown effect"):
                for effect in effects:
                    parse_effect(effect)  # which says what there is
            raise SimulationError(said)
        _joined(simulated, concealed, effects, Path(path))
    return count


def _joined(simulated: Path, concealed: Path, effects: Sequence[str], out: Path) -> None:
    """The truth of one file and the readings of another, in the order of time."""
    messages = []
    for path, of_truth in ((simulated, True), (concealed, False)):
        with path.open("rb") as file:
            messages += [m for m in make_reader(file).iter_messages()
                         if m[1].topic.startswith(TRUTH) == of_truth]  # fmt: skip
    with out.open("wb") as file:
        writer = Writer(file, chunk_size=64 * 1024, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="handcal simulate")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for schema, channel, message in sorted(messages, key=lambda m: m[2].log_time):
            assert schema is not None
            data = message.data
            if channel.topic == PARAMETERS:
                data = json.dumps({**json.loads(data), "concealed": list(effects)}).encode()
            if schema.name not in schemas:
                schemas[schema.name] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.topic not in channels:
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.name]
                )
            writer.add_message(
                channels[channel.topic], message.log_time, data, message.publish_time,
                message.sequence,
            )  # fmt: skip
        writer.finish()  # type: ignore[no-untyped-call]
