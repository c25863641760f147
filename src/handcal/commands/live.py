"""The command ``live``. What is slow to import is imported where it is used."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handcal.commands._device import DeviceFile, ModelName, PriorsFile, before_of
from handcal.commands._options import (
    AS_IT_IS,
    Anyway,
    Effects,
    Reading,
    Rrd,
    comma_separated,
    load,
    reads_recordings,
)
from handcal.commands._registry import say, tell

if TYPE_CHECKING:
    from handcal.live.ending import Ended, Wanted
    from handcal.live.progress import Board
    from handcal.live.run import Pull
    from handcal.live.session import Session
    from handcal.recordings.inputs import Options
    from handcal.types import Prior, Recording


@reads_recordings
def live(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="The folder to write to.")
    ] = Path("live-out"),
    lan: Annotated[
        bool,
        typer.Option("--lan", help="Serve the page to the local network too, encrypted; without "
                     "it, to this machine alone."),
    ] = False,
    plain: Annotated[
        bool,
        typer.Option("--plain", help="With --lan, without encryption: for apps that push and "
                     "accept no new certificate. Anyone on the network can read "
                     "the data."),
    ] = False,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of the page; any free one if not "
                     "given.")
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Practise with a recording instead of a "
                     "phone, without a page."),
    ] = None,
    speed: Annotated[
        float, typer.Option(min=0.0, help="With --from, speed relative to real time; 0: as fast "
                     "as possible.")
    ] = 1.0,
    phyphox: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Read from the phyphox app at this address (remote "
                     "access)."),
    ] = None,
    follow: Annotated[
        Path | None,
        typer.Option(metavar="FILE.mcap", help="Follow the MCAP file that a ROS 2 recorder is "
                     "writing."),
    ] = None,
    foxglove: Annotated[
        str | None,
        typer.Option(metavar="ws://HOST:PORT", help="Listen to a Foxglove WebSocket "
                     "(foxglove_bridge)."),
    ] = None,
    effects: Effects = "",
    until: Annotated[
        str,
        typer.Option(metavar="EFFECT=SIGMA,...", help="End when these sigmas are reached: "
                     "gyro_scale=0.1%,gyro_bias=15deg/h."),
    ] = "",
    device: DeviceFile = None,
    priors: PriorsFile = None,
    model: ModelName = None,
    how: Reading = AS_IT_IS,
    budget: Annotated[
        float | None,
        typer.Option(min=0.0, metavar="SECONDS", help="Time limit of the search, as in explain."),
    ] = None,
    anyway: Anyway = False,
    dashboard: Annotated[
        bool, typer.Option("--dashboard", help="Show the session in the Rerun viewer.")
    ] = False,
    web: Annotated[
        bool, typer.Option("--web", help="Show it in a browser instead of a window.")
    ] = False,
    rrd: Rrd = None,
) -> None:  # fmt: skip
    """Record a phone as it moves, propose the next turn, and explain the recording.

    Open the link on the phone, do what the page says, press Stop (or Ctrl-C here). The app Sensor
    Logger pushes to the link with push appended; --phyphox, --follow, --foxglove read from others.
    Writes recording.mcap, calibration.json, explanation.json, report.html and exports. What was
    recorded survives a crash: start again with the same folder, and the same link stays valid.
    """
    from handcal.live.recorder import opened
    from handcal.live.session import Session

    places = _Places(lan, plain, port, source, speed, phyphox, follow, foxglove, how)
    places.check()
    _check_outputs(out, rrd, (source, follow, device, priors))
    recording = None if source is None else load(source, how)
    if recording is None:
        _check_installed()
    wanted = _wanted(effects, until, (device, priors, model), budget, places.is_page,
                     anyway)  # fmt: skip
    pull, named = _pull(places)
    out.mkdir(parents=True, exist_ok=True)
    session = Session(opened(out / "recording.mcap"), source=named)
    if session.recorder.samples:
        say(f"continuing after {session.recorder.seconds:.0f} s that were recorded before")
    with _board(dashboard or web, web, rrd) as board:
        if recording is None:
            ended = _served(session, out, places, wanted, pull, board)
        else:
            from handcal.live.run import fed

            ended = fed(session, recording, speed, out, wanted, say, board)
    tell(ended.headline)
    for sentence in ended.sentences:
        tell(sentence)
    for warning in ended.warnings:
        tell(f"Warning: {warning}")
    tell(f"{out}: {', '.join(ended.files)}")


@dataclass(frozen=True)
class _Places:
    """Where the page is, and where readings come from, as typed."""

    lan: bool
    plain: bool
    port: int | None
    source: Path | None
    speed: float
    phyphox: str | None
    follow: Path | None
    foxglove: str | None
    how: Reading

    @property
    def is_page(self) -> bool:
        """Readings come from the page, or are pushed."""
        return all(x is None for x in (self.source, self.phyphox, self.follow, self.foxglove))

    def check(self) -> None:
        """Errors: InputError for options that do not go together."""
        from handcal.types import InputError

        several = [("--from", self.source), ("--phyphox", self.phyphox), ("--follow", self.follow),
                   ("--foxglove", self.foxglove)]  # fmt: skip
        named = [option for option, value in several if value is not None]
        if len(named) > 1:
            raise InputError(f"{' and '.join(named)}: one source at a time.")
        if self.plain and not self.lan:
            raise InputError("--plain needs --lan: on this machine alone nothing is encrypted.")


def _check_outputs(out: Path, rrd: Path | None, read: tuple[Path | None, ...]) -> None:
    """Errors: InputError where the session would replace what it reads."""
    from handcal.live.ending import EXPORTED, EXPORTS, FILES
    from handcal.output import check_outputs

    own = [*(out / name for name in FILES), *(out / EXPORTED / name for _, name in EXPORTS)]
    check_outputs((rrd, *(path for path in own if path.exists())), read)


def _wanted(
    effects: str, until: str, known: tuple[Path | None, Path | None, str | None],
    budget: float | None, is_page: bool, anyway: bool,
) -> Wanted:  # fmt: skip
    """What was asked for. Errors: InputError."""
    from handcal.effects import select
    from handcal.live.ending import Wanted
    from handcal.live.goals import parse

    ids = comma_separated(effects)
    select(ids)
    goals = dict(parse(until))
    before = before_of(*known, [])
    if before is not None and not ids:  # (what is known of the device is estimated on)
        ids = tuple(dict.fromkeys(e for e, _ in before.names if not e.endswith("_bias")))
    ids = tuple(dict.fromkeys((*ids, *(e for e in goals if not e.endswith("_bias")))))

    def renewed(recording: Recording) -> Prior | None:
        return before_of(*known, [recording])

    typed = [
        word
        for option, value in zip(("--device", "--priors", "--model"), known, strict=True)
        if value is not None
        for word in (option, str(value))
    ]
    return Wanted(ids, before, goals, budget, is_page, renewed, typed=tuple(typed),
                  anyway=anyway)  # fmt: skip


@contextlib.contextmanager
def _board(shown: bool, web: bool, rrd: Path | None) -> Iterator[Board | None]:
    """The dashboard, where one is wanted."""
    if not shown and rrd is None:
        yield None
        return
    import os

    from handcal.show.viewer import require_display

    if shown and not web:
        require_display()
    os.environ.setdefault("RUST_LOG", "warn,re_grpc_client=off,re_sdk=off")
    from handcal.show.dashboard.session import board

    with board(show=shown, web=web, rrd=rrd, say=say) as made:
        yield made


def _check_installed() -> None:
    from importlib.util import find_spec

    from handcal.live.link import NEEDED
    from handcal.types import InputError

    if find_spec("aiohttp") is None:
        raise InputError(f"{NEEDED}.")


def _served(
    session: Session, out: Path, places: _Places, wanted: Wanted, pull: Pull | None,
    board: Board | None,
) -> Ended:  # fmt: skip
    import asyncio

    from handcal.live.link import link_of, qr
    from handcal.live.run import serve

    link = link_of(out, places.lan, places.port, places.plain)

    def ready() -> None:
        print(qr(link.url) + link.url, flush=True)
        if places.lan and not places.plain:
            say("the phone will warn that it does not know the certificate, which was made here: "
                "continue anyway (Advanced, Proceed; on iOS Show Details, visit)")  # fmt: skip
        elif places.plain:
            say(
                "not encrypted: browsers give no sensor readings to such a page; use an app that "
                "pushes"
            )
        else:
            say("the page can be opened on this machine alone; --lan serves it to a phone")
        if places.is_page:
            say(f"Sensor Logger pushes to {link.url}push")

    return asyncio.run(serve(session, link, out, wanted, say, ready, pull, board))


def _pull(places: _Places) -> tuple[Pull | None, str]:
    """How readings are asked for, None where they come by themselves; and from where they are.
    Errors: InputError."""
    if places.phyphox is not None:
        from handcal.live.sources.phyphox import found

        phone = found(places.phyphox)

        def asked(into: Session) -> bool:
            phone.poll(into)
            return not phone.ended

        return asked, "phyphox"
    if places.follow is not None:
        from handcal.live.sources.mcap import growing

        return growing(places.follow, _options(places)).pull, "recorder"
    if places.foxglove is not None:
        from handcal.live.sources.foxglove import connected

        return connected(places.foxglove, _options(places)).pull, "foxglove"
    return None, "page" if places.source is None else "file"


def _options(places: _Places) -> Options:
    """What was said of the topics and units of a file."""
    from handcal.recordings.inputs._options import checked_options
    from handcal.types import InputError

    said = places.how.said
    if said["columns"] or said["rate_hz"] or said["axes"]:
        raise InputError("--columns, --rate and --axes are for the file of --source.")
    return checked_options(said["topics"], said["units"], None)
