"""isocenter calibrate spot: the focal spot's motion on its tube."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import MachineArgument, can_be_written, load
from hil.cli.paged import PageOption, check_page, write_paged
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import follower, progress


def register(app: typer.Typer) -> None:
    """Add the command to `isocenter calibrate`."""
    app.command(
        short_help="The focal spot's motion on its tube, from a marker plate at rest.",
        help="How the focal spot moves on its tube, from images of a marker plate while the machine stands still:"
        " heat and the anode's turning."
        "\n\nExample:  isocenter calibrate spot carm still_marker --anode 48.3 --figure spot.png",
    )(spot)


def spot(
    machine_name: MachineArgument,
    scan_folder: Annotated[Path, typer.Argument(metavar="SCAN", help="Folder of marker images, the machine at rest.")],
    anode: Annotated[float | None, typer.Option("--anode", metavar="HZ", help="Turns of the anode a second.")] = None,
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="Displacement and spectrum.")] = None,
    jobs: Annotated[int, typer.Option("--jobs", metavar="N", min=1, help="Processes that look at images.")] = 1,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Find the plate twice, tell."""
    import numpy as np

    from hil.calibration.marker.focal_spot import spot_track
    from hil.imaging.markers import PLATES
    from hil.imaging.nominal import nominal_beam
    from hil.imaging.scan_folder import read_scan

    if anode is not None and not 0.0 < anode < np.inf:
        raise UnusableInputError(f"--anode {anode:g}: must be a positive number")
    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(figure)
    check_page(page)
    scan = read_scan(scan_folder)
    name, distance_mm = scan.notes.get("marker"), scan.notes.get("marker_distance_mm")
    if name not in PLATES or not isinstance(distance_mm, (int, float)):
        raise UnusableInputError(f"{scan_folder}/scan.toml names no marker of {', '.join(PLATES)} and marker_distance_mm")
    beam = nominal_beam(machine, np.nan_to_num(scan.positions))
    with progress() as bars:
        follow = follower(bars, bars.add_task("marker", total=2 * len(scan)))
        track = spot_track(scan, PLATES[name](), beam, 1e-3 * float(distance_mm), jobs, lambda done, total: follow(done))
    drift, sigma = 1e6 * track.drift_m, 1e6 * float(np.median(track.sigma_m))
    seconds = track.time_s[-1] - track.time_s[0]
    answer.say(f"{len(scan)} exposures over {seconds:.1f} s at {track.rate_Hz:.2f} Hz, the spot's place in one to {sigma:.2f} um")
    answer.say(f"drift {drift[0]:.1f} um along columns, {drift[1]:.1f} um along rows")
    frequencies, amplitudes = track.spectrum()
    strongest = int(np.argmax(amplitudes.max(axis=1)))
    answer.say(f"strongest line at {frequencies[strongest]:.2f} Hz among the frames, {1e6 * amplitudes[strongest].max():.1f} um")
    document: dict[str, object] = {
        "time_s": track.time_s,
        "spot_m": track.spot_m,
        "sigma_m": track.sigma_m,
        "drift_m": track.drift_m,
        "frequencies_Hz": frequencies,
        "amplitudes_m": amplitudes,
    }
    if anode is not None:
        alias, wobble = track.line(anode)
        answer.say(f"anode at {anode:g} Hz: shows at {alias:.2f} Hz, wobble {1e6 * wobble[0]:.1f} and {1e6 * wobble[1]:.1f} um")
        document |= {"anode_alias_Hz": alias, "anode_wobble_m": wobble}
    if figure is not None:
        from hil.figures.focal_spot import spot_figure

        save_figure(spot_figure(track, anode, f"{scan_folder.name}: focal spot on its tube"), figure)
        answer.say(f"{figure}: displacement and spectrum")
    if page is not None:
        from hil.reports.spot import spot_page

        write_paged(answer, spot_page(machine, track, anode, scan_folder, answer.said), page)
    answer.write(document)
