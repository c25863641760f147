"""The command ``calibrate``. What is slow to import is imported where it is used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handcal.commands._device import (
    DeviceFile,
    ModelName,
    PriorsFile,
    before_of,
    contradictions,
)
from handcal.commands._options import (
    AS_IT_IS,
    Anyway,
    Assume,
    Assumption,
    Effects,
    Engine,
    EngineOption,
    HeadingSigma,
    Height,
    Ignore,
    Json,
    Latitude,
    NoiseUntil,
    Only,
    Reading,
    ReferenceExact,
    Report,
    Rrd,
    calibrated,
    in_units,
    load,
    reads_recordings,
    with_own_effects,
)

if TYPE_CHECKING:
    from handcal.types import Result


@with_own_effects
@in_units
@reads_recordings
def calibrate(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Recordings of one device.")
    ],
    effects: Effects = "",
    only: Only = False,
    learnt_from: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="RESULT.json",
            help="Repeat the fit in a file of `explain --json` or `calibrate --json`; for other "
            "recordings, estimate the same effects.",
        ),
    ] = None,
    anyway: Anyway = False,
    device: DeviceFile = None,
    priors: PriorsFile = None,
    model: ModelName = None,
    heading_sigma: HeadingSigma = None,
    assume: Assumption = Assume.auto,
    latitude: Latitude = None,
    height: Height = 0.0,
    how: Reading = AS_IT_IS,
    ignore: Ignore = None,
    reference_exact: ReferenceExact = False,
    noise_until: NoiseUntil = None,
    engine: EngineOption = Engine.compiled,
    json: Json = None,
    report: Report = None,
    rrd: Rrd = None,
) -> None:
    """Estimate the sensor errors of one device from its recordings, with their sigmas.

    Errors that every device has are always estimated; --effects adds others. Several recordings
    share these errors, while biases and noise are estimated for each recording. --from repeats
    the fit of a result; for other recordings, it estimates the same effects. With --device,
    earlier sessions of the device are the prior; values and sigmas then combine all sessions.
    """
    from handcal.output import beside, check_outputs

    read = (*files, learnt_from, device, priors)
    check_outputs((json, report, rrd), read)
    recordings = [load(path, how) for path in files]
    for several in (report, rrd):
        if several:
            check_outputs(beside(several, recordings), read)
    before = before_of(device, priors, model, recordings)
    results = calibrated(
        recordings, effects, learnt_from, heading_sigma=heading_sigma, assume=assume,
        latitude=latitude, height=height, ignore=ignore, reference_exact=reference_exact,
        noise_until=noise_until, engine=engine, before=before, only=only, anyway=anyway,
    )  # fmt: skip
    results = tuple(
        replace(r, warnings=(*r.warnings, *contradictions(r.before, r.parameters, r.covariance)))
        for r in results
    )
    if report:
        from handcal.show.calibration.report import write_report

        for result, path in zip(results, beside(report, recordings), strict=True):
            write_report(result, path)
    if rrd:
        from handcal.show.dashboard import save_rrd

        for result, path in zip(results, beside(rrd, recordings), strict=True):
            save_rrd(result, path)
    if json:
        from handcal.show.calibration.summary import calibration_json, write_json

        write_json(calibration_json(results), json)
    if str(json) != "-":  # last: the reader may close it before its end
        for result in results:
            _show(result)


def _show(result: Result) -> None:
    from handcal.show.calibration.terminal import print_summary
    from handcal.show.console import Terminal

    print_summary(result, Terminal())
