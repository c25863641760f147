"""The command `simulate`. What is slow to import is imported where it is used."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from handcal.commands._options import say_what_runs
from handcal.commands._registry import tell
from handcal_sim.commands._wrong_use import wrong_use


def simulate(
    scenario: Annotated[
        str,
        typer.Argument(
            help="By hand: z-turn, three-turns, free-hand, travel, static. On equipment, with the "
            "known input as /reference: table-poses, steady-spins, dividing-head, soak."
        ),
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FILE.mcap", help="The recording to write.")
    ],
    heading_sigma: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="White noise of heading, deg (5; perfect device: 0)."),
    ] = None,
    no_heading: Annotated[bool, typer.Option("--no-heading", help="No heading sensor.")] = False,
    seed: Annotated[
        int | None, typer.Option(help="Same seed, same file (drawn, and said).")
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ID=v,v,...",
            help="Set an effect, values in the order of its parameters (repeatable); "
            "a wrong one lists them. What only `handcal conceal` knows is added by it.",
        ),
    ] = None,
    effects_from: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Effect files (*.py) of your own, for `handcal conceal`. This runs their code: "
            "name no folder that you do not trust.",
        ),
    ] = None,
    device: Annotated[
        str | None,
        typer.Option(help="consumer (drawn at random; default), paper (paper 002) or perfect."),
    ] = None,
    perfect: Annotated[bool, typer.Option("--perfect", help="Same as --device perfect.")] = False,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Sampling rate of the IMU (100).")
    ] = None,
    heading_rate: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="Rate of heading (consumer: 50; else with the IMU)."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="Length; turns are stretched to it.")
    ] = None,
    bias_gyro_deg_h: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Gyro biases, deg/h.")
    ] = None,
    bias_accel_mg: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Accelerometer biases, mg.")
    ] = None,
    temperature: Annotated[
        bool, typer.Option("--temperature", help="Report the temperature too.")
    ] = False,
    mag: Annotated[bool, typer.Option("--mag", help="With a magnetometer.")] = False,
    pose: Annotated[bool, typer.Option("--pose", help="With measured poses.")] = False,
    reference: Annotated[
        bool, typer.Option("--reference", help="With a trusted IMU on the same body.")
    ] = False,
    no_sway: Annotated[
        bool, typer.Option("--no-sway", help="A hand that holds perfectly still.")
    ] = False,
    sway: Annotated[
        float | None,
        typer.Option(help="Scale of hand sway and tremor (1; paper device: 0)."),
    ] = None,
    latitude: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="True gravity and Earth rate there."),
    ] = None,
    height: Annotated[
        float, typer.Option(metavar="M", help="Height above the ellipsoid, with --latitude.")
    ] = 0.0,
    start_heading: Annotated[
        float | None, typer.Option(metavar="DEG", help="Yaw at the start (random; paper: 0).")
    ] = None,
    start_tilt: Annotated[
        str | None,
        typer.Option(metavar="PITCH,ROLL", help="Tilt at the start, deg (random; paper: 0,0)."),
    ] = None,
    clockwise: Annotated[
        bool | None,
        typer.Option(
            "--clockwise/--counter-clockwise", help="Which way it turns (random; paper: counter-)."
        ),
    ] = None,
    table_errors: Annotated[
        str | None,
        typer.Option(
            metavar="ARCSEC,ARCMIN",
            help="Equipment: error of each axis in each pose, and tilt of the base, rms (0,0).",
        ),
    ] = None,
    spin: Annotated[
        float | None, typer.Option(metavar="DEG/S", help="Rate of steady-spins (100).")
    ] = None,
) -> None:
    """Write a recording of a simulated device in a simulated hand, and what was true."""
    from handcal.output import check_outputs, whole
    from handcal.recordings.export import check_ending
    from handcal.types import InputError
    from handcal.user_effects import files
    from handcal_sim.effects import parted
    from handcal_sim.request import Request, simulated

    if perfect and device not in (None, "perfect"):
        raise InputError(f"--perfect is --device perfect, not {device}: give one of them.")
    own, others = parted(effect or ())
    request = Request(
        scenario=scenario, seed=seed, device="perfect" if perfect else device or "consumer",
        effects=own, rate_hz=rate, duration_s=duration,
        heading=not no_heading, heading_sigma_deg=heading_sigma, heading_rate_hz=heading_rate,
        bias_gyro_deg_h=bias_gyro_deg_h, bias_accel_mg=bias_accel_mg,
        temperature=temperature, mag=mag, pose=pose, reference=reference,
        sway=0.0 if no_sway else sway, latitude_deg=latitude, height_m=height,
        start_heading_deg=start_heading, start_tilt_deg=start_tilt, clockwise=clockwise,
        table_errors=table_errors, spin_deg_s=spin,
    )  # fmt: skip
    check_outputs((out,), files(effects_from) if effects_from else ())
    check_ending(out)
    if effects_from:
        say_what_runs(effects_from)
    with wrong_use():
        world, used = simulated(request)
        from handcal_sim import foreign
        from handcal_sim.mcap_writer import write

        with whole(out) as place:
            count = (
                foreign.write(world, place, others, used, effects_from)
                if others
                else write(world, place)
            )
    if seed is None:
        print(f"seed {used}", file=sys.stderr)
    streams = ", ".join(f"/{name}" for name in ("imu", *world.streams))
    length = world.parameters["duration_s"]
    tell(f"{out}: {scenario}, {length:g} s, {streams}; {count} messages, seed {used}")
