"""isocenter calibrate convergence: parameters as states of one filter with the motion, on drawn runs of a known machine."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli.options import can_be_written
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import progress

if TYPE_CHECKING:
    from hil.calibration.parameter_states.drawn_runs import Conditions
    from hil.calibration.parameter_states.filter_model import SwingingMachine
    from hil.calibration.parameter_states.study import Draw

SHOWN = (0, 1, 2, 5, 10, 15, 20, 30, 40, 60, 80)
"""Numbers of images that the answer has a line for."""


def register(calibrate: typer.Typer) -> None:
    """Add the command to the group."""
    calibrate.command(
        short_help="How many images it takes until parameters are known.",
        help="How many images it takes until a machine's parameters are known: Denavit-Hartenberg rows with gear ratios, focal spot,"
        " compliances, frequencies, dampings and masses as states of one filter with the motion (thesis Chapter 5), on drawn runs."
        "\n\nCHAIN is a file of `calibrate chain` with a table [[mode]] per mode: name, row (0: the panel's mount, k: before joint k),"
        " axis, point_m, frequency_Hz, damping, compliance_rad_Nm, mass_kg, center_of_mass_m, gain_rad_s2 (per joint, per unit of"
        " effort); and source_m, gravity_m_s2, [imu] position_m."
        "\n\nExample:  isocenter calibrate convergence carm.chain.toml --draws 15 --figure fig58.png"
        "\n\nImages withdrawn, drift followed:  isocenter calibrate convergence carm.chain.toml --seconds 40 --withdraw 20 --drift 5"
        "\n\nRobustness:  isocenter calibrate convergence carm.chain.toml --robustness --draws 5",
    )(convergence)


def convergence(
    chain_file: Annotated[Path, typer.Argument(metavar="CHAIN", help="The drawing: where the filter starts (.toml).")],
    true_file: Annotated[
        Path | None, typer.Option("--true", metavar="CHAIN", help="The machine as built; else drawn within the drawing's tolerance.")
    ] = None,
    draws: Annotated[int, typer.Option("--draws", metavar="N", min=1, help="Runs.")] = 15,
    seconds: Annotated[float, typer.Option("--seconds", metavar="S", help="Length of a run.")] = 20.0,
    image_rate: Annotated[float, typer.Option("--image-rate", metavar="HZ", help="Images a second.")] = 2.0,
    late: Annotated[float, typer.Option("--late", metavar="MS", min=0.0, help="How long after its exposure an image is there.")] = 200.0,
    withdraw: Annotated[int | None, typer.Option("--withdraw", metavar="N", min=0, help="Leave images out after so many.")] = None,
    drift: Annotated[
        float, typer.Option("--drift", metavar="PERCENT", help="The frequencies fall by so much over a run, and the filter follows.")
    ] = 0.0,
    robustness: Annotated[bool, typer.Option("--robustness", help="Runs unlike what the filter believes.")] = False,
    seed: Annotated[int, typer.Option("--seed", help="Of the first run.")] = 0,
    figure: Annotated[
        Path | None, typer.Option("--figure", metavar="PNG", help="Convergence of the first four parameters (Fig. 5.8).")
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", metavar="N", min=1, help="Processors that runs may use; all by default. Same answer."),
    ] = None,
    json_to: JsonOption = None,
) -> None:
    """Draw runs, filter them, judge."""
    from hil.calibration.parameter_states import study
    from hil.calibration.parameter_states.chain_modes import read_swinging
    from hil.calibration.parameter_states.drawn_runs import Conditions
    from hil.calibration.parameter_states.summary import along_table, convergence_table

    for option, value in (("--seconds", seconds), ("--image-rate", image_rate)):
        if not 0.0 < value < float("inf"):
            raise UnusableInputError(f"{option} {value:g}: must be a positive number")
    if not 0.0 <= drift < 50.0:
        raise UnusableInputError(f"--drift {drift:g}: must be from 0 to 50 percent")
    if seconds * image_rate < 2.0 or seconds < 2.0:
        raise UnusableInputError(f"--seconds {seconds:g} --image-rate {image_rate:g}: a run must last 2 s and hold two images at least")
    if robustness and (withdraw is not None or drift):
        raise UnusableInputError("--robustness has conditions of its own: leave --withdraw and --drift out")
    answer = Answer(json_to)
    can_be_written(*([figure] if figure else []))
    start = read_swinging(chain_file)
    true = None if true_file is None else _as_built(start, read_swinging(true_file), true_file)
    conditions = Conditions(seconds=seconds, images_Hz=image_rate, late_s=1e-3 * late)
    if robustness:
        answer.write({"robustness": _robustness(answer, start, true, conditions, draws, seed, jobs)})
        return
    made: list[Draw] = []
    told = study.falling(0.01 * drift, seconds) if drift else None
    of_seed = partial(study.draw_of, start, true, conditions=conditions, withdrawn=withdraw, drift=told)
    with progress() as bars:
        task = bars.add_task("runs", total=draws)
        for each in study.side_by_side(of_seed, range(seed, seed + draws), jobs):
            made.append(each)
            bars.update(task, completed=len(made))
    document = convergence_table(start, made, conditions, is_drawn=true is None)
    _say_tables(answer, document, seconds)
    document["along"] = along_table(made, conditions, 0.01 * drift)
    if withdraw is not None or drift:
        _say_along(answer, document["along"], withdraw, drift)
    if figure is not None:
        from hil.figures.convergence import convergence_figure

        names = start.chain.names[:4]
        errors = document["curves"]
        picture = convergence_figure(names, start.chain.units[:4], [errors[name] for name in names])
        save_figure(picture, figure)
        answer.say(f"{figure}: {', '.join(names)} over images")
    answer.write(document)


def _as_built(start: SwingingMachine, true: SwingingMachine, path: Path) -> SwingingMachine:
    """Return the start with the parameters of another file; loads stay those of the drawing."""
    from dataclasses import replace

    for what, ours, theirs in (
        ("joints", start.chain.chain.joints, true.chain.chain.joints),
        ("modes", tuple(each.name for each in start.chain.elastic), tuple(each.name for each in true.chain.elastic)),
    ):
        if ours != theirs:
            raise UnusableInputError(f"{path}: has {what} {', '.join(theirs)}; the drawing's are {', '.join(ours)}")
    return replace(
        start,
        chain=start.chain.with_values(true.chain.values),
        frequency_Hz=true.frequency_Hz,
        damping=true.damping,
        gain=true.gain,
    )


def _say_tables(answer: Answer, found: dict[str, Any], seconds: float) -> None:
    rows = found["convergence"]
    answer.say(f"{found['runs']} runs of {seconds:g} s; poses that no image showed, rms, median and worst of the runs:")
    for k in sorted({each for each in (*SHOWN, len(rows) - 1) if each < len(rows)}):
        row = rows[k]
        answer.say(
            f"  after {k:3d} images {1e3 * row['held_out_m']:8.3f} mm {1e3 * row['held_out_rad']:8.3f} mrad,"
            f" worst {1e3 * row['worst_m']:8.3f} mm"
        )
    what, when = "what a single image is unsure by", found["converged"]
    answer.say(f"  converged after {when} images: below {what}" if when is not None else f"  not converged: above {what} at the end")
    if found["model_based"] is not None:
        fitted = found["model_based"]
        answer.say(
            f"  model-based, all images at once: {1e3 * fitted['held_out_m']:.3f} mm {1e3 * fitted['held_out_rad']:.3f} mrad;"
            " it takes vibration for noise"
        )
    answer.say(f"  {'parameter':30s}{'start':>11s}{'true':>11s}   rms error by the model, by the filter, and stated by it")
    for name, entry in found["parameters"].items():
        true = f"{entry['true']:11.6g}" if "true" in entry else f"{'drawn':>11s}"
        model = f"{entry['model_error_rms']:9.2g}" if "model_error_rms" in entry else f"{'-':>9s}"
        answer.say(f"  {name:30s}{entry['start']:11.6g}{true}   {model} {entry['error_rms']:9.2g} {entry['stated']:9.2g} {entry['unit']}")
    nees = found["nees"]
    answer.say("  frequencies, dampings and masses: logarithms of their ratios to the start")
    answer.say(
        f"  squared errors over what is stated (1: true): chain {nees['chain']:.2f}, modes {nees['dynamic']:.2f},"
        f" poses along the runs {nees['poses']:.2f}; {found['refused']} images refused"
    )
    if found["widened"]:
        answer.say(f"  in {found['widened']} runs no image agreed with the drawing, and its tolerances were doubled")


def _say_along(answer: Answer, rows: list[dict[str, float]], withdraw: int | None, drift: float) -> None:
    images = "all images" if withdraw is None else f"images withdrawn after {withdraw}"
    answer.say(f"along the runs, {images}, frequencies fall by {drift:g} %:")
    for row in rows:
        answer.say(
            f"  {row['from_s']:6.1f} to {row['to_s']:5.1f} s: phantom off {1e3 * row['phantom_m']:.3f} mm, stated"
            f" {1e3 * row['stated_m']:.3f}; frequencies off {1e2 * row['frequency_share']:.2f} %, at the start's values"
            f" {1e2 * row['frequency_start_share']:.2f} %"
        )


def _robustness(
    answer: Answer,
    start: SwingingMachine,
    true: SwingingMachine | None,
    conditions: Conditions,
    draws: int,
    seed: int,
    jobs: int | None,
) -> dict[str, Any]:
    from hil.calibration.parameter_states.study import CONDITIONS
    from hil.calibration.parameter_states.summary import robustness_rows

    result: dict[str, Any] = {}
    answer.say(f"medians of {draws} runs; squared errors over what is stated are 1 where it is true")
    with progress() as bars:
        task = bars.add_task("conditions", total=len(CONDITIONS))
        for name, row in robustness_rows(start, true, conditions, draws, seed, jobs):
            result[name] = row
            when = "never converged" if row["converged"] is None else f"{row['converged']} images"
            answer.say(
                f"  {name:34s} {1e3 * row['held_out_m']:7.3f} mm, worst {1e3 * row['worst_m']:7.3f}; {when}; squared errors: chain"
                f" {row['nees_chain']:.2f}, modes {row['nees_dynamic']:.2f}, poses {row['nees_poses']:.2f}; frequency off"
                f" {1e2 * row['frequency_share']:.2f} %; {row['refused']} refused"
            )
            bars.update(task, completed=len(result))
    return result
