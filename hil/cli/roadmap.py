"""isocenter roadmap: overlay errors of calibrations at benchmark poses, as the thesis's Table 2.3."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import MachineArgument, can_be_written, load
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure


def register(parent: typer.Typer) -> None:
    """Add the command."""
    parent.command(
        short_help="Overlay errors of calibrations at benchmark poses.",
        help="Overlay errors on the panel at the image's centre, 1/3 and 2/3 of the way to its border, over benchmark poses: largest,"
        " largest of the best 90 %, mean."
        "\n\nExample:  isocenter roadmap carm benchmark.npz --with grid.npz --with carm.model.npz"
        "\n\nBENCHMARK is a table of isocenter calibrate phantom, or the truth of the emulated machine: isocenter geometry truth.",
    )(roadmap)


def roadmap(
    machine_name: MachineArgument,
    benchmark: Annotated[Path, typer.Argument(metavar="BENCHMARK", help="Table of what the geometry is at the benchmark poses (.npz).")],
    calibrations: Annotated[
        list[Path] | None, typer.Option("--with", metavar="FILE", help="A look-up table or a model to judge; repeat. Nominal always is.")
    ] = None,
    registered: Annotated[
        bool,
        typer.Option("--registered/--as-it-is", help="First lay each calibration's world on the true one, as a volume made with it lies."),
    ] = False,
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="Distribution of the errors.")] = None,
    json_to: JsonOption = None,
) -> None:
    """Compare calibrations."""
    from hil.calibration.kinematic.geometric_model import read_calibration
    from hil.calibration.use.lookup_table import LookUp
    from hil.calibration.use.roadmap import PLACES, overlay
    from hil.calibration.use.roadmap import registered as laid_over
    from hil.imaging.nominal import nominal_beam, nominal_detector

    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(figure)
    table = read_calibration(benchmark, machine)
    if not isinstance(table, LookUp):
        raise UnusableInputError(f"{benchmark}: a model has no poses of its own; the benchmark is a table of isocenter calibrate phantom")
    nominal = nominal_beam(machine, table.positions)
    detector = nominal_detector(machine)
    true = nominal.moved(table.deviation)
    candidates = {"nominal": nominal}
    for path in calibrations or ():
        candidates[path.name] = nominal.moved(read_calibration(path, machine).at(table.positions))
    if registered:
        candidates = {name: laid_over(true, beam, detector) for name, beam in candidates.items()}
    found = {name: overlay(true, beam, detector) for name, beam in candidates.items()}
    width = max(len(name) for name in found)
    answer.say(f"overlay errors on the panel [mm] at {len(true)} poses: largest / largest of the best 90 % / mean")
    answer.say(f"  {'':{width}s}  " + "  ".join(f"{place:^23s}" for place in PLACES))
    for name, result in found.items():
        cells = [f"{1e3 * row['max']:7.3f}/{1e3 * row['max_90']:7.3f}/{1e3 * row['mean']:7.3f}" for row in result.table.values()]
        answer.say(f"  {name:{width}s}  " + "  ".join(cells))
    if figure is not None:
        from hil.figures.roadmap import roadmap_figure

        laid = "every calibration's world laid on the true one" if registered else "worlds as they are"
        save_figure(roadmap_figure(found, f"Overlay errors at {len(true)} poses of {benchmark.name}, {laid}"), figure)
        answer.say(f"{figure}: distribution of the errors")
    answer.write({"poses": len(true), "registered": registered, "overlay_m": {name: result.table for name, result in found.items()}})
