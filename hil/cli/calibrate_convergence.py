"""isocenter calibrate convergence: parameters as states of one filter with the motion, on drawn runs of a known machine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli.options import can_be_written
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import progress

if TYPE_CHECKING:
    import numpy as np

    from hil.calibration.parameter_states.drawn_runs import Conditions
    from hil.calibration.parameter_states.model import SwingingMachine
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
    json_to: JsonOption = None,
) -> None:
    """Draw runs, filter them, judge."""
    from hil.calibration.parameter_states import study
    from hil.calibration.parameter_states.chain_modes import read_swinging
    from hil.calibration.parameter_states.drawn_runs import Conditions

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
        answer.write({"robustness": _robustness(answer, start, true, conditions, draws, seed)})
        return
    made: list[Draw] = []
    told = study.falling(0.01 * drift, seconds) if drift else None
    with progress() as bars:
        task = bars.add_task("runs", total=draws)
        for k in range(draws):
            machine = true or study.drawn_machine(start, study.randomness(start), seed + k)
            made.append(study.draw(start, machine, seed + k, conditions, withdraw, told))
            bars.update(task, completed=k + 1)
    document = _tables(answer, start, made, conditions, is_drawn=true is None)
    document["along"] = _along(answer, made, conditions, drift, withdraw)
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

    if start.chain.names != true.chain.names:
        raise UnusableInputError(f"{path}: has joints or modes of other names than the drawing: {', '.join(true.chain.names)}")
    return replace(
        start,
        chain=start.chain.with_values(true.chain.values),
        frequency_Hz=true.frequency_Hz,
        damping=true.damping,
        gain=true.gain,
    )


def _tables(answer: Answer, start: SwingingMachine, made: list[Draw], conditions: Conditions, is_drawn: bool) -> dict[str, Any]:
    import numpy as np

    from hil.calibration.parameter_states import study

    held = study.curve(made, conditions.reach_rad)
    median = np.median(held, axis=0)
    when = study.converged(median, conditions)
    answer.say(f"{len(made)} runs of {conditions.seconds:g} s; poses that no image showed, rms, median and worst of the runs:")
    for k in sorted({each for each in (*SHOWN, held.shape[1] - 1) if each < held.shape[1]}):
        answer.say(f"  after {k:3d} images {1e3 * median[k, 0]:8.3f} mm {1e3 * median[k, 1]:8.3f} mrad, worst {1e3 * held[:, k, 0].max():8.3f} mm")
    what = "stays below what one image is unsure by"
    answer.say(f"  converged after {when} images: {what}" if when is not None else f"  not converged: never {what}")
    count = held.shape[1]
    target = np.array([each.target for each in made])
    last = np.array([each.found.values[-1] for each in made]) - target
    stated = np.sqrt(np.mean([each.found.deviations[-1] ** 2 for each in made], axis=0))
    models = [study.by_model(start, each.run) for each in made]
    fits = np.array([model.values - each.true.chain.values for model, each in zip(models, made, strict=True) if model is not None])
    fitted = [study.held_out(each.true.chain, m, conditions.reach_rad) for m, each in zip(models, made, strict=True) if m is not None]
    names, p = made[0].found.names, len(start.chain.names)
    units = (*start.chain.units, *["-"] * (len(names) - p))
    answer.say(f"  {'parameter':30s} {'start':>11s} {'' if is_drawn else 'true':>11s}   model-based       data-driven       stated")
    parameters = {}
    start_values = np.concatenate([start.chain.values, np.zeros(len(names) - p)])
    for k, name in enumerate(names):
        entry = {"unit": units[k], "start": float(start_values[k])}
        if not is_drawn:
            entry["true"] = float(target[0, k])
        entry |= {"error_mean": float(last[:, k].mean()), "error_rms": _rms(last[:, k]), "stated": float(stated[k])}
        if k < p and len(fits):
            entry |= {"model_error_mean": float(fits[:, k].mean()), "model_error_rms": _rms(fits[:, k])}
        parameters[name] = entry
        built = "" if is_drawn else f"{target[0, k]:11.6g}"
        model = f"{entry['model_error_rms']:9.2g}" if "model_error_rms" in entry else ""
        answer.say(f"  {name:30s} {start_values[k]:11.6g} {built:>11s}   {model:>9s} off    {entry['error_rms']:9.2g} off   {stated[k]:9.2g} {units[k]}")
    nees = np.array([each.nees() for each in made])
    along = np.concatenate([each.gaps()[1] for each in made])
    answer.say(f"  dynamic parameters: logarithms of ratios to the start; {sum(len(each.found.refused) for each in made)} images refused")
    answer.say(
        f"  squared errors over what is stated (1: true): chain {nees[:, 0].mean():.2f}, dynamic {nees[:, 1].mean():.2f},"
        f" poses along the runs {along.mean():.2f}"
    )
    return {
        "runs": len(made),
        "images": count - 1,
        "converged": when,
        "convergence": [
            {"images": k, "held_out_m": a, "held_out_rad": b, "worst_m": c}
            for k, ((a, b), c) in enumerate(zip(median.tolist(), held[:, :, 0].max(axis=0).tolist(), strict=True))
        ],
        "model_based": {"held_out_m": float(np.median([a for a, _ in fitted])), "held_out_rad": float(np.median([b for _, b in fitted]))}
        if fitted
        else None,
        "parameters": parameters,
        "curves": {
            name: {
                "error_mean": [float(np.mean([each.found.values[i][k] - each.target[k] for each in made])) for i in range(count)],
                "error_std": [float(np.std([each.found.values[i][k] - each.target[k] for each in made])) for i in range(count)],
                "stated": [float(np.mean([each.found.deviations[i][k] for each in made])) for i in range(count)],
            }
            for k, name in enumerate(names[:4])
        },
        "nees": {"chain": float(nees[:, 0].mean()), "dynamic": float(nees[:, 1].mean()), "poses": float(along.mean())},
        "refused": sum(len(each.found.refused) for each in made),
    }


def _along(answer: Answer, made: list[Draw], conditions: Conditions, drift: float, withdraw: int | None) -> list[dict[str, float]]:
    """Say how far poses and frequencies are off along the runs, in eighths."""
    import numpy as np

    from hil.calibration.parameter_states.study import falling

    fall = falling(0.01 * drift, conditions.seconds)
    edges = np.linspace(0.0, conditions.seconds, 9)
    if withdraw is not None or drift:
        answer.say(f"  along the runs, images withdrawn after {withdraw if withdraw is not None else 'none'}, frequencies fall by {drift:g} %:")
    gaps = [each.gaps() for each in made]
    rows = []
    for first, stop in zip(edges[:-1], edges[1:], strict=True):
        place, stated, squares, wrong, still = [], [], [], [], []
        for each, (gap, square) in zip(made, gaps, strict=True):
            at = np.array(each.found.at_s)
            part = np.flatnonzero((at >= first) & (at < stop))
            m = each.true.modes
            place += np.sum(gap[part, 3:6] ** 2, axis=1).tolist()
            stated += [float(np.trace(each.found.covariances[k][3:6, 3:6])) for k in part]
            squares += square[part].tolist()
            logs = np.array([each.found.dynamic[k][:m] for k in part]).reshape(-1, m)
            true = each.target[len(each.true.chain.names) :][:m] + np.log([fall(t) / fall(float(each.run.time_s[-1])) for t in at[part]])[:, None]
            wrong += ((np.exp(logs - true) - 1.0) ** 2).ravel().tolist()
            still += ((np.exp(-true) - 1.0) ** 2).ravel().tolist()
        rows.append(
            {
                "from_s": float(first),
                "to_s": float(stop),
                "phantom_m": float(np.sqrt(np.mean(place))),
                "stated_m": float(np.sqrt(np.mean(stated))),
                "nees": float(np.mean(squares)),
                "frequency_share": float(np.sqrt(np.mean(wrong))),
                "frequency_start_share": float(np.sqrt(np.mean(still))),
            }
        )
        if withdraw is not None or drift:
            row = rows[-1]
            answer.say(
                f"  {first:6.1f} to {stop:5.1f} s: phantom {1e3 * row['phantom_m']:.3f} mm, stated {1e3 * row['stated_m']:.3f},"
                f" NEES {row['nees']:.2f}; frequencies off {1e2 * row['frequency_share']:.2f} %, kept at the start"
                f" {1e2 * row['frequency_start_share']:.2f} %"
            )
    return rows


def _robustness(
    answer: Answer, start: SwingingMachine, true: SwingingMachine | None, conditions: Conditions, draws: int, seed: int
) -> dict[str, Any]:
    import numpy as np

    from hil.calibration.parameter_states import study

    result: dict[str, Any] = {}
    answer.say(f"medians of {draws} runs: poses that no image showed, images until converged, squared errors over what is stated (1: true)")
    with progress() as bars:
        task = bars.add_task("conditions", total=len(study.CONDITIONS))
        for number, (name, changes) in enumerate(study.CONDITIONS.items(), start=1):
            made = [study.under(start, true, seed + k, conditions, changes) for k in range(draws)]
            moving = made[0].run.encoder
            reach = np.where(np.ptp(moving, axis=0) > 1e-2, np.max(conditions.reach_rad), 0.0)
            held, everywhere = study.curve(made, reach), study.curve(made, conditions.reach_rad)[:, -1]
            nees = np.array([each.nees() for each in made])
            along = [float(each.gaps()[1].mean()) for each in made]
            m, p = start.modes, len(start.chain.names)
            off = [np.abs(np.expm1(each.found.values[-1][p : p + m] - each.target[p : p + m])).max() for each in made]
            result[name] = {
                "held_out_m": float(np.median(held[:, -1, 0])),
                "everywhere_m": float(np.median(everywhere[:, 0])),
                "worst_m": float(held[:, -1, 0].max()),
                "converged": study.converged(np.median(held, axis=0), conditions),
                "nees_chain": float(np.median(nees[:, 0])),
                "nees_dynamic": float(np.median(nees[:, 1])),
                "nees_poses": float(np.median(along)),
                "frequency_share": float(np.median(off)),
                "refused": sum(len(each.found.refused) for each in made),
            }
            row = result[name]
            when = row["converged"]
            answer.say(
                f"  {name:34s} {1e3 * row['held_out_m']:7.3f} mm, worst {1e3 * row['worst_m']:7.3f}; {'never' if when is None else when}"
                f" images; chain {row['nees_chain']:.2f}, dynamic {row['nees_dynamic']:.2f}, poses {row['nees_poses']:.2f};"
                f" frequency {1e2 * row['frequency_share']:.2f} %; {row['refused']} refused"
            )
            bars.update(task, completed=number)
    return result


def _rms(values: np.ndarray) -> float:
    return float((values**2).mean() ** 0.5)
