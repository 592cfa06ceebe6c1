"""isocenter lpv: the modal model over poses of one axis or two (5.35), and responses over poses as surfaces."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli.emulated import EMULATED
from hil.cli.options import can_be_written
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import working

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hil.identification import FrequencyResponse, ModalFrfModel


MOST_AXES = 2  # that the model is a function of


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Modes over poses: the modal LPV model.",
        help="The modal LPV model (5.35) of frequency responses at three poses or more along one axis, or six or more over two: natural"
        " frequencies and damping ratios as polynomials of the pose, with 95 % bounds, and its state space with --json; orders are chosen"
        " from the data."
        "\n\nWith --surface and --variances the responses themselves, over frequency and pose."
        "\n\nExample:  isocenter lpv carm_p*.frf.npz --figure modes.png --surface surfaces.png --json model.json",
    )(lpv)


def lpv(
    frfs: Annotated[list[Path], typer.Argument(metavar="FRF...", help="Frequency responses, one per pose, at the same lines.")],
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="Draw the modes over the pose.")] = None,
    surface: Annotated[Path | None, typer.Option("--surface", metavar="PNG", help="Draw magnitudes over frequency and pose.")] = None,
    variances: Annotated[Path | None, typer.Option("--variances", metavar="PNG", help="Draw deviations, averaged over the poses.")] = None,
    at: Annotated[
        str,
        typer.Option(
            "--at",
            metavar="X,X,...",
            help="Poses [deg or mm] to evaluate it at, of two axes X:Y,X:Y,...; those of the responses unless given.",
        ),
    ] = "",
    linear: Annotated[bool, typer.Option("--mm", help="The axis is prismatic: poses in mm instead of degrees.")] = False,
    json_to: JsonOption = None,
) -> None:
    """Read, draw, fit, say the modes at every pose."""
    import numpy as np

    from hil.identification import fit_modal_model, read_frf

    answer = Answer(json_to)
    can_be_written(figure, surface, variances)
    responses = [read_frf(path) for path in frfs]
    directions = _directions(responses)
    scale, unit = (1e-3, "mm") if linear else (math.pi / 180.0, "deg")
    wanted = _poses(at, scale, len(directions))
    if len(directions) > 1 and (surface or variances):
        raise UnusableInputError("--surface, --variances: draw poses along one axis, and two vary between the responses'")
    ordered = sorted(responses, key=lambda response: [response.pose[column] for column in directions])
    emulated = any(response.emulated for response in responses)
    title = f"{EMULATED if emulated else ''}{len(ordered)} poses"
    if surface is not None:
        from hil.figures.frf_over_poses import surface_figure

        save_figure(surface_figure(ordered, directions[0], angle=not linear, title=title), surface)
        answer.say(f"{surface}: magnitudes over frequency and pose")
    if variances is not None:
        from hil.figures.frf_over_poses import variance_figure

        save_figure(variance_figure({ordered[0].method: ordered}, title=title), variances)
        answer.say(f"{variances}: deviations")
    with working("fitting"):
        model = fit_modal_model(ordered, directions)
    found = [_at(model, pose) for pose in (wanted or model.poses.tolist())]
    modes, states = len(found[0]["natural_frequency_Hz"]), len(found[0]["A"])
    answer.say(f"{title}: {modes} modes, {states} states, misfit {model.fit.misfit:.3g} (1: noise alone)")
    for each in found:
        shown = ", ".join(
            f"{frequency:.4g} ± {half:.2g} Hz ({100.0 * ratio:.3g} ± {100.0 * width:.2g} %)"
            for frequency, half, ratio, width in zip(
                *(each[name] for name in ("natural_frequency_Hz", "natural_frequency_ci95", "damping", "damping_ci95")), strict=True
            )
        )
        left = "" if each["stable"] else "; its state space is not stable: a pole outside the band is not damped"
        pose = ", ".join(f"{value / scale:8.4g}" for value in np.atleast_1d(each["pose"]))
        answer.say(f"  {pose} {unit}: {shown}{left}")
    if figure is not None:
        from hil.figures.modes import modes_figure

        commands = responses[0].input_names
        names = tuple(commands[column].partition("_")[2] for column in directions) if len(commands) == len(responses[0].pose) else ()
        save_figure(modes_figure(model, angle=not linear, title=title, axes_names=names), figure)
        answer.say(f"{figure}: natural frequencies and damping ratios over the pose")
    answer.write(
        {
            "emulated": emulated,
            "direction": directions[0] if len(directions) == 1 else list(directions),
            "pose_range": model.pose_range[0] if len(directions) == 1 else model.pose_range,
            "misfit": model.fit.misfit,
            "outputs": model.output_names,
            "inputs": model.input_names,
            "poses": found,
        }
    )


def _at(model: ModalFrfModel, pose: list[float]) -> dict[str, Any]:
    frequency, damping, frequency_half, damping_half = model.modes(pose)
    system = model.state_space(pose)
    return {
        "pose": pose[0] if len(pose) == 1 else pose,
        "natural_frequency_Hz": frequency,
        "natural_frequency_ci95": frequency_half,
        "damping": damping,
        "damping_ci95": damping_half,
        "stable": model.is_stable(pose),
        "A": system.A,
        "B": system.B,
        "C": system.C,
        "D": system.D,
    }


def _directions(responses: Sequence[FrequencyResponse]) -> tuple[int, ...]:
    """Return which coordinates of the poses vary, one or two."""
    import numpy as np

    counts = {len(response.pose) for response in responses}
    if counts == {0} or len(counts) > 1:
        raise UnusableInputError("the responses carry no poses, or of different machines: give one machine's, from recordings at poses")
    spread = np.ptp([response.pose for response in responses], axis=0)
    varying = np.flatnonzero(spread > 1e-3)
    if not 1 <= len(varying) <= MOST_AXES:
        vary = f"{len(varying)} axes vary" if len(varying) else "no axis varies"
        raise UnusableInputError(f"{vary} between the responses' poses: give poses along one axis, or over two")
    return tuple(varying.tolist())


def _poses(text: str, scale: float, axes: int) -> list[list[float]]:
    such_as = "-30,0,30" if axes == 1 else "-30:0,0:45"
    try:
        poses = [[scale * float(value) for value in part.split(":")] for part in text.split(",")] if text else []
    except ValueError:
        raise typer.BadParameter(f"--at {text}: must be numbers, such as {such_as}") from None
    if any(len(pose) != axes for pose in poses):
        raise typer.BadParameter(f"--at {text}: the poses vary in {axes} {'axis' if axes == 1 else 'axes'}; give them such as {such_as}")
    return poses
