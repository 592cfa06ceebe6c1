"""isocenter calibrate consistency: what has changed in a scan's geometry, from its own images."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import MachineArgument, ScanArgument, can_be_written, load
from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import progress


def register(app: typer.Typer) -> None:
    """Add the command to `isocenter calibrate`."""
    app.command(
        short_help="What has changed in a scan's geometry, from its own images, without a phantom.",
        help="What has changed in a scan's geometry, from its own images, without a phantom: every plane through two focal spots is seen in"
        " both images. Any object will do that lies whole in view. Where the images do not say that something has changed, no table is"
        " written, and the status is 1."
        "\n\nExample:  isocenter calibrate consistency carm vessel_scan --lookup roll.lookup.npz -o today.lookup.npz",
    )(consistency)


def consistency(
    machine_name: MachineArgument,
    scan_folder: ScanArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="LOOKUP", help="Look-up table to write (.npz).")],
    lookup: Annotated[
        Path | None, typer.Option("--lookup", metavar="LOOKUP", help="Look-up table or model to begin from; nominal without.")
    ] = None,
    json_to: JsonOption = None,
) -> None:
    """Read, fit, tell."""
    import numpy as np

    from hil.calibration.consistency.recalibrate import recalibrate
    from hil.calibration.kinematic.geometric_model import read_calibration
    from hil.calibration.use.lookup_table import LookUp, sweep_speed, write_look_up
    from hil.imaging.nominal import nominal_beam
    from hil.imaging.scan_folder import read_scan

    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(out)
    scan = read_scan(scan_folder)
    positions = scan.positions_of(machine)
    nominal = nominal_beam(machine, positions)
    before = nominal if lookup is None else nominal.moved(read_calibration(lookup, machine).at(positions))
    with progress() as bars:
        task = bars.add_task("comparing", total=None)
        found = recalibrate(scan.frame, scan.detector, before, lambda done, total: bars.update(task, completed=done, total=total))
    answer.write(
        {
            "images": found.images,
            "pairs": found.pairs,
            "changed": found.sure,
            "gain": found.gain,
            "moved_mm": 1e3 * found.moved_m,
            "stated_mm": 1e3 * found.stated_m,
            "contradiction_before": found.before,
            "contradiction_after": found.after,
            "deviation": found.deviation,
            "sigma": np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2)),
        }
    )
    begun = lookup or f"the drawing of {machine.name}"
    if not found.sure:
        answer.say(
            f"{found.pairs} pairs of {found.images} images say nothing more than {begun}: a change of {1e3 * found.moved_m:.3f} mm, sure to"
            f" {1e3 * found.stated_m:.3f} mm, explains them {odds(found.gain)} as well as none. No table is written; keep what you have"
        )
        raise typer.Exit(1)
    speed = [float(each) if np.isfinite(each) else None for each in sweep_speed(scan.middle_s, positions)]
    notes = {"machine": machine.name, "hash": machine.hash, "speed": speed, "consistency": True}
    after = before.moved(found.deviation)
    write_look_up(LookUp(scan.axes, positions, after.deviation_from(nominal), found.covariance, notes), out)
    answer.say(
        f"{found.pairs} pairs of {found.images} images say that shadows lie {1e3 * found.moved_m:.3f} mm from where {begun} has them"
        f" (rms on the panel), sure to {1e3 * found.stated_m:.3f} mm"
    )
    answer.say("the scan's place and size stay as they were: its images do not show them")
    answer.say(f"{out}: look-up table of {len(scan)} exposures; reconstruct with --lookup {out}")


def odds(gain: float) -> str:
    """Return what twice a logarithm of odds means."""
    times = math.exp(0.5 * min(gain, 40.0))
    return f"{times:.0f} times" if times >= 1.5 else "just"
