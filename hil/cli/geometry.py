"""isocenter geometry: the geometry of a scan's exposures as files, volumes and images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli import exchange
from hil.cli.options import MachineArgument, PoseOption, ScanArgument, can_be_written, folder_can_be_written, load, not_an_input, parse_pose
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import progress

app = typer.Typer(
    no_args_is_help=True,
    short_help="The geometry of exposures: files, volume, images.",
    help="The geometry of a scan's exposures: written for other programs, its reconstruction volume, images as if it were nominal."
    "\n\nExample:  isocenter geometry volume carm scan --with carm.model.npz",
)

WithOption = Annotated[
    Path | None, typer.Option("--with", metavar="FILE", help="Look-up table or model; the nominal geometry unless given.")
]


def register(parent: typer.Typer) -> None:
    """Add the commands."""
    app.command(
        short_help="The nine parameters of a pose.",
        help="The nine parameters (2.2) of a pose, as a look-up table or a model predicts them."
        "\n\nExample:  isocenter geometry at carm carm.model.npz --pose propeller=20,roll=-45",
    )(at)
    app.command(
        short_help="The true geometry of an emulated scan.",
        help="The true geometry of an emulated machine's exposures, as a table that other calibrations are judged by."
        "\n\nExample:  isocenter geometry truth carm scan --truth truth.csv -o scan.truth.npz",
    )(truth)
    app.command(
        short_help="Of a table, the poses at which the machine stood.",
        help="Of a table, the poses at which the machine stood, the exposures of each averaged."
        "\n\nExample:  isocenter geometry standing benchmark.true.npz -o benchmark.npz",
    )(standing)
    app.command(
        short_help="What a scan can reconstruct.",
        help="The reconstruction volume of a scan: the points that all of its exposures see."
        "\n\nExample:  isocenter geometry volume carm scan --with carm.model.npz",
    )(volume)
    app.command(
        short_help="Images shifted and turned to the nominal geometry.",
        help="A scan's images shifted and turned as if the machine had been where it should, as another scan folder."
        "\n\nExample:  isocenter geometry compensate carm scan --with carm.model.npz -o compensated",
    )(compensate)
    exchange.register(app)
    parent.add_typer(app, name="geometry")


def at(
    machine_name: MachineArgument,
    calibration: Annotated[Path, typer.Argument(metavar="FILE", help="Look-up table or model (.npz).")],
    pose: PoseOption = "",
    json_to: JsonOption = None,
) -> None:
    """Write nominal and predicted geometry, and the model's uncertainty."""
    import numpy as np

    from hil.calibration.kinematic.geometric_model import GeometricModel, read_calibration
    from hil.imaging.geometry import DEVIATIONS, NAMES
    from hil.imaging.nominal import nominal_beam

    machine = load(machine_name)
    answer = Answer(json_to)
    wanted = parse_pose(pose, machine)
    positions = np.array([[wanted.get(axis, 0.0) for axis in machine.axes]])
    found = read_calibration(calibration, machine)
    nominal = nominal_beam(machine, positions)
    deviation = found.at(positions)
    beam = nominal.moved(deviation)
    sigma = np.full(9, np.nan)
    if isinstance(found, GeometricModel):
        sigma = np.sqrt(np.diag(found.covariance_at(positions)[0]))
    for k, name in enumerate(NAMES):
        unit = "mm" if k < 6 else "mrad"
        known = "" if np.isnan(sigma[k]) else f", sigma {1e3 * sigma[k]:.3f}"
        off = f"deviation in {DEVIATIONS[k]} {1e3 * deviation[0, k]:+.3f}{known}"
        answer.say(f"  {name:10s} {1e3 * beam.parameters[0, k]:10.3f} {unit:4s} nominal {1e3 * nominal.parameters[0, k]:10.3f}; {off}")
    answer.write(
        {
            "pose": dict(zip(machine.axes, positions[0], strict=True)),
            "parameters": dict(zip(NAMES, beam.parameters[0], strict=True)),
            "nominal": dict(zip(NAMES, nominal.parameters[0], strict=True)),
            "deviation": dict(zip(DEVIATIONS, deviation[0], strict=True)),
            "sigma": dict(zip(DEVIATIONS, sigma, strict=True)),
        }
    )


def truth(
    machine_name: MachineArgument,
    scan_folder: ScanArgument,
    truth_file: Annotated[Path, typer.Option("--truth", metavar="FILE", help="Truth file of the scan's run.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="TABLE", help="Table to write (.npz).")],
    emulated: Annotated[
        str | None, typer.Option("--emulated", metavar="M", help="Machine that was emulated, where it is another than M, the drawing.")
    ] = None,
    json_to: JsonOption = None,
) -> None:
    """Write the true geometry, without the focal spot's motion on the tube."""
    import numpy as np

    from hil.calibration.use.lookup_table import LookUp, write_look_up
    from hil.emulated.images import true_beam, xray_side
    from hil.imaging.nominal import nominal_beam
    from hil.imaging.scan_folder import read_scan
    from virtual_bus.xray.motion import STILL

    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(out)
    scan = read_scan(scan_folder)
    positions = scan.positions_of(machine)
    true = true_beam(xray_side(load(emulated or machine_name), truth_file, STILL, 0.0), scan.start_s, scan.width_s)
    deviation = true.deviation_from(nominal_beam(machine, positions))
    notes = {"machine": machine.name, "hash": machine.hash, "truth": truth_file.name}
    write_look_up(LookUp(scan.axes, positions, deviation, np.tile(KNOWN**2 * np.eye(9), (len(scan), 1, 1)), notes), out)
    answer.say(f"{out}: true geometry of {len(scan)} exposures")
    answer.write({"table": out, "exposures": len(scan), "deviation": deviation})


def standing(
    table: Annotated[Path, typer.Argument(metavar="TABLE", help="Look-up table (.npz).")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="TABLE", help="Table to write (.npz).")],
    json_to: JsonOption = None,
) -> None:
    """Average the poses at which the machine stood, as calibrate phantom --standing does."""
    from hil.calibration.use.lookup_table import read_look_up, write_look_up
    from hil.calibration.use.lookup_table import standing as where_it_stood

    answer = Answer(json_to)
    can_be_written(out)
    not_an_input(out, table)
    poses = where_it_stood(read_look_up(table))
    write_look_up(poses, out)
    answer.say(f"{out}: {len(poses.positions)} poses")
    answer.write({"table": out, "poses": poses.positions})


KNOWN = 1e-6
"""Standard deviation of the truth, a micrometre and a microradian: between the emulator's samples the motion is interpolated."""


def volume(machine_name: MachineArgument, scan_folder: ScanArgument, calibration: WithOption = None, json_to: JsonOption = None) -> None:
    """Compute the reconstruction volume (2.1), exactly."""
    from hil.calibration.kinematic.geometric_model import read_calibration
    from hil.calibration.use.volume import reconstruction_volume
    from hil.imaging.nominal import nominal_beam
    from hil.imaging.scan_folder import read_scan

    machine = load(machine_name)
    answer = Answer(json_to)
    scan = read_scan(scan_folder)
    positions = scan.positions_of(machine)
    beam = nominal_beam(machine, positions)
    ideal = reconstruction_volume(beam, scan.detector)
    if calibration is not None:
        beam = beam.moved(read_calibration(calibration, machine).at(positions))
    found = reconstruction_volume(beam, scan.detector)
    answer.say(
        f"{len(scan)} exposures all see {1e3 * found.volume_m3:.2f} l, a ball of {1e3 * found.radius_m:.1f} mm about the isocentre in it"
        + ("" if calibration is None else f"; nominal {1e3 * ideal.volume_m3:.2f} l and {1e3 * ideal.radius_m:.1f} mm")
    )
    answer.write({"volume_m3": found.volume_m3, "radius_m": found.radius_m, "corners_m": found.corners_m})


def compensate(
    machine_name: MachineArgument,
    scan_folder: ScanArgument,
    calibration: Annotated[Path, typer.Option("--with", metavar="FILE", help="Look-up table or model.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Scan folder to write.")],
    json_to: JsonOption = None,
) -> None:
    """Turn and shift every image."""
    import numpy as np

    from hil.calibration.kinematic.geometric_model import read_calibration
    from hil.calibration.use.compensation import compensated, compensation
    from hil.extras import extra_package
    from hil.imaging.nominal import nominal_beam
    from hil.imaging.scan_folder import FRAMES, read_scan, write_description, write_exposures

    machine = load(machine_name)
    answer = Answer(json_to)
    folder_can_be_written(out)
    tifffile = extra_package("tifffile", "images")
    scan = read_scan(scan_folder)
    if out.exists() and out.samefile(scan_folder):
        raise UnusableInputError(f"{out}: is read by this command; write to another folder")
    positions = scan.positions_of(machine)
    wanted = nominal_beam(machine, positions)
    motion = compensation(wanted.moved(read_calibration(calibration, machine).at(positions)), wanted)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tifffile.TiffWriter(out / FRAMES) as frames, progress() as bars:
            task = bars.add_task("images", total=len(scan))
            for k in range(len(scan)):
                image = scan.frame(k)
                moved = compensated(image, motion.turn_rad[k], motion.shift_m[k], scan.detector)
                frames.write(np.clip(np.round(moved), 0, np.iinfo(image.dtype).max).astype(image.dtype), contiguous=True)
                bars.update(task, completed=k + 1)
        write_description(out, scan.detector, scan.axes, {**scan.notes, "compensated_with": calibration.name})
        units = dict(zip(scan.axes, scan.units, strict=True))
        write_exposures(out, scan.exposure_id, scan.start_s, scan.width_s, units, scan.positions)
    except OSError as error:
        raise UnusableInputError(f"{out}: cannot be written: {error.strerror or error}") from None
    answer.say(
        f"{out}: {len(scan)} images turned by up to {1e3 * np.abs(motion.turn_rad).max():.2f} mrad and shifted by up to"
        f" {1e3 * np.linalg.norm(motion.shift_m, axis=1).max():.2f} mm; {1e3 * motion.left_m.max():.3f} mm at most stay within 50 mm"
    )
    answer.write({"folder": out, "turn_rad": motion.turn_rad, "shift_m": motion.shift_m, "left_m": motion.left_m})
