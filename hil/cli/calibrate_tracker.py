"""isocenter calibrate tracker: poses of an external tracker, as truth for a calibration or input to one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import MachineArgument, can_be_written, load, not_an_input
from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import working


def register(app: typer.Typer) -> None:
    """Add the command to `isocenter calibrate`."""
    app.command(
        short_help="The geometry that an external tracker shows.",
        help="Lays the poses that an external tracker saw of panel and tube on the nominal geometry, or on a calibration, and writes what"
        " it shows as a look-up table. How the targets are mounted is fitted: constant errors do not show."
        "\n\nPOSES is a CSV: time [s or ms], and detector_ and source_ each x, y, z [mm] and the quaternion qx, qy, qz, qw."
        "\n\nExample:  isocenter calibrate tracker carm scan.mf4 poses.csv --against roll.lookup.npz -o tracker.lookup.npz",
    )(tracker)


def tracker(
    machine_name: MachineArgument,
    recording_file: Annotated[Path, typer.Argument(metavar="REC", help="Recording of the same motion, for its axis positions.")],
    poses_file: Annotated[Path, typer.Argument(metavar="POSES", help="What the tracker saw (.csv).")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="TABLE", help="Look-up table to write (.npz).")],
    against: Annotated[
        Path | None, typer.Option("--against", metavar="TABLE", help="Calibration to lay the poses on, and to judge.")
    ] = None,
    later: Annotated[float, typer.Option("--later", metavar="S", help="What the tracker's clock shows at the first row.")] = 0.0,
    position: Annotated[float, typer.Option("--position-sigma", metavar="MM", min=1e-6, help="Of a target's place.")] = 0.05,
    rotation: Annotated[float, typer.Option("--rotation-sigma", metavar="MRAD", min=1e-6, help="Of its turn about each axis.")] = 0.1,
    json_to: JsonOption = None,
) -> None:
    """Read, lay on, tell, write."""
    from hil.calibration.use.lookup_table import read_look_up, write_look_up
    from hil.calibration.use.tracker import read_tracker, rms_of, tracked_table
    from hil.recording import read_recording

    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(out, suffixes=(".npz",))
    for path in (recording_file, poses_file, *([against] if against is not None else [])):
        not_an_input(out, path)
    poses, recording = read_tracker(poses_file), read_recording(recording_file, machine)
    table = None if against is None else read_look_up(against)
    with working("laying the poses on the geometry"):
        found, laid = tracked_table(
            machine, recording, poses, position_sigma_m=1e-3 * position, rotation_sigma_rad=1e-3 * rotation, later_s=later, against=table
        )
    rms, noise = rms_of(laid, found)
    label = "nominal geometry" if against is None else str(against)
    answer.say(f"{len(found.positions)} poses of the tracker, {poses.lost} lines without one of the targets")
    for name, (value, known) in {each: (rms[each], noise[each]) for each in rms}.items():
        kind, unit = name.rsplit("_", 1)
        shown = "mrad" if unit == "rad" else "mm"
        answer.say(f"  {kind}: {1e3 * value:.3f} {shown} rms from the {label}, of which the tracker's noise makes {1e3 * known:.3f}")
    write_look_up(found, out)
    answer.say(f"{out}: what the tracker shows, a table over {', '.join(machine.axes)}")
    answer.write({"table": out, "poses": len(found.positions), "lost": poses.lost, "rms": rms, "noise": noise})
