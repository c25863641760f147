"""Design an experiment: the poses, or the turns in the hand, that determine chosen errors best.

What is slow to import is imported where it is used.
"""

from __future__ import annotations

import secrets
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from handcal.commands._options import (
    AS_IT_IS,
    Assume,
    Assumption,
    HeadingSigma,
    Height,
    Json,
    Latitude,
    Reading,
    Report,
    Rrd,
    comma_separated,
    load,
    radians,
    reads_recordings,
    with_own_effects,
)
from handcal.commands._progress import progress
from handcal.commands._registry import say

design = typer.Typer(
    add_completion=False, pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip

MOST_POSES = 60


class Criterion(StrEnum):
    """What a set of poses is to make small."""

    D = "D"
    A = "A"
    condition = "condition"


class Known(StrEnum):
    """What is known of each pose."""

    norm = "norm"
    pose = "pose"
    rate = "rate"
    spin = "spin"


@design.callback()
def _root() -> None:
    """Find the poses, or the turns in the hand, that determine chosen errors best."""


@design.command()
@with_own_effects
def poses(
    n: Annotated[int, typer.Option("--n", min=1, max=MOST_POSES, help="How many poses.")] = 9,
    effects: Annotated[
        str,
        typer.Option(
            metavar="ID,...", help="Effects that the poses are to determine; biases always are."
        ),
    ] = "accel_scale,accel_misalignment",
    known: Annotated[
        Known,
        typer.Option(
            help="What is known of each pose. norm: the magnitude of gravity alone; pose: the "
            "attitude; rate: a steady turn about the vertical; spin: the same turn, "
            "compared with a rest in that pose."
        ),
    ] = Known.norm,
    criterion: Annotated[
        Criterion,
        typer.Option(
            help="What to minimise. D: volume of uncertainty; A: mean variance; condition: "
            "condition number."
        ),
    ] = Criterion.D,
    sequential: Annotated[
        bool,
        typer.Option(
            "--sequential/--global", help="Choose one pose after the other, or all at once."
        ),
    ] = False,
    rate: Annotated[
        float, typer.Option(metavar="DEG/S", help="Rate of the turns, with --known rate or spin.")
    ] = 100.0,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Same seed, same poses; random and printed if not given."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw the poses (.png, .svg, .pdf).")
    ] = None,
    json: Json = None,
    report: Report = None,
    rrd: Rrd = None,
) -> None:
    """Find the poses that determine chosen errors best, and the sigmas that they would give."""
    import math

    import numpy as np

    from handcal.design.poses import experiment
    from handcal.design.search import design as search
    from handcal.output import check_outputs
    from handcal.show.calibration.summary import write_json
    from handcal.show.design import report as design_report
    from handcal.show.design.picture import check_ending, save_picture

    check_outputs((json, report, rrd, picture))
    if picture:
        check_ending(picture)
    ids = comma_separated(effects)
    asked = experiment(ids, str(known), math.radians(rate))
    seed = secrets.randbelow(2**31) if seed is None else seed
    with progress(f"searching {n} poses") as bar:
        found = search(
            asked, n, str(criterion), np.random.default_rng(seed), sequential, progress=bar
        )
    if picture:
        save_picture(found, picture)
    if report:
        design_report.write_design_report(found, report)
    if rrd:
        from handcal.show.dashboard import save_poses_rrd

        save_poses_rrd(found, rrd)
    if json:
        write_json(design_report.design_json(found) | {"seed": seed}, json)
    if str(json) != "-":
        from handcal.show.console import Terminal

        design_report.print_design(found, Terminal())
        if not sequential:
            say(f"seed {seed}")


@design.command()
@with_own_effects
@reads_recordings
def motion(
    reduce: Annotated[
        str,
        typer.Option(
            metavar="ID,...",
            help="Whose uncertainty to reduce: effects, gyro_bias, accel_bias.",
        ),
    ],
    after: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Recording that was made already; none if not given."),
    ] = None,
    beside: Annotated[
        str,
        typer.Option(
            metavar="ID,...", help="Further effects that are unknown and have to be estimated."
        ),
    ] = "",
    heading_sigma: HeadingSigma = None,
    assume: Assumption = Assume.auto,
    latitude: Latitude = None,
    height: Height = 0.0,
    how: Reading = AS_IT_IS,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw the gain of each motion.")
    ] = None,
    json: Json = None,
    report: Report = None,
) -> None:
    """Find the turn in the hand that would reduce the uncertainty of chosen parameters most.

    Without --after, nothing is known of the device yet; --heading-sigma then gives it a heading.
    """
    from handcal.design.motion import plan
    from handcal.output import check_outputs
    from handcal.show.calibration.summary import write_json
    from handcal.show.design import motion_report
    from handcal.show.design.picture import check_ending

    check_outputs((json, report, picture), (after,))
    if picture:
        check_ending(picture)
    wanted, others = comma_separated(reduce), comma_separated(beside)
    recording = None if after is None else load(after, how)
    with progress("asking each motion") as bar:
        found = plan(
            wanted, recording, beside=others, assume=str(assume),
            heading_sigma=radians(heading_sigma), latitude=radians(latitude), height=height,
            progress=bar,
        )  # fmt: skip
    if picture:
        motion_report.save_motion_picture(found, picture)
    if report:
        motion_report.write_motion_report(found, report)
    if json:
        write_json(motion_report.motion_json(found), json)
    if str(json) != "-":
        from handcal.show.console import Terminal

        motion_report.print_motions(found, Terminal())
