"""The command ``replay``. What is slow to import is imported where it is used."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handcal.commands._options import (
    AS_IT_IS,
    Assume,
    Assumption,
    Effects,
    Engine,
    EngineOption,
    HeadingSigma,
    Height,
    Ignore,
    Latitude,
    NoiseUntil,
    Reading,
    Rrd,
    calibrated,
    load,
    radians,
    reads_recordings,
    with_own_effects,
)
from handcal.commands._registry import say

if TYPE_CHECKING:
    pass


@with_own_effects
@reads_recordings
def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording.")],
    speed: Annotated[
        float, typer.Option(min=0.0, help="Speed relative to real time; 0: as fast as possible.")
    ] = 1.0,
    web: Annotated[
        bool, typer.Option("--web", help="Watch in a browser instead of a window.")
    ] = False,
    no_viewer: Annotated[bool, typer.Option("--no-viewer", help="Only write --rrd.")] = False,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of the viewer, on this machine only.")
    ] = None,
    rrd: Rrd = None,
    effects: Effects = "",
    heading_sigma: HeadingSigma = None,
    assume: Assumption = Assume.auto,
    latitude: Latitude = None,
    height: Height = 0.0,
    how: Reading = AS_IT_IS,
    ignore: Ignore = None,
    noise_until: NoiseUntil = None,
    engine: EngineOption = Engine.compiled,
) -> None:
    """Run the filter over a recording as if live, and show it in the Rerun viewer as it goes.

    The recording is calibrated first, to find the noise levels.
    """
    from handcal.output import check_outputs
    from handcal.show.viewer import require_display
    from handcal.types import InputError

    if no_viewer and rrd is None:
        raise InputError("--no-viewer without --rrd FILE.rrd leaves nothing to do: add --rrd.")
    check_outputs((rrd,), (file,))
    recording = load(file, how)
    if not (no_viewer or web):
        require_display()
    (result,) = calibrated(
        [recording], effects, heading_sigma=heading_sigma, assume=assume,
        latitude=latitude, height=height, ignore=ignore, noise_until=noise_until, engine=engine,
    )  # fmt: skip
    # rerun reports a viewer that its owner has closed as errors; set before its import
    os.environ.setdefault("RUST_LOG", "warn,re_grpc_client=off,re_sdk=off")
    from handcal.estimate.live import live_frames
    from handcal.show import dashboard
    from handcal.show.frames import layout_of

    frames = live_frames(result, latitude=radians(latitude), height=height, engine=str(engine))
    layout = layout_of(result, live=True)
    dashboard.replay(
        frames, layout, speed=speed, rrd=rrd, show=not no_viewer, web=web, port=port, say=say
    )
