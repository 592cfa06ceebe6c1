"""isocenter calibrate model and scan: the kinematic model fitted to phantom-calibrated scans, and the scans that show its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import MachineArgument, can_be_written, edge_scale, load, not_an_input
from hil.cli.paged import PageOption, check_page, write_paged
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import follower, progress, working

if TYPE_CHECKING:
    import numpy as np

    from hil.calibration.kinematic.flexible import FlexibleFit
    from hil.calibration.kinematic.geometric_model import GeometricModel
    from hil.calibration.use.lookup_table import LookUp
    from hil.machine import Machine


def register(calibrate: typer.Typer) -> None:
    """Add the commands to the group."""
    calibrate.command(
        "model",
        short_help="A kinematic model with gravity, from phantom-calibrated scans.",
        help="A Denavit-Hartenberg model whose joints give way under gravity, fitted to phantom-calibrated scans; it predicts the nine"
        " parameters of any pose."
        "\n\nExample:  isocenter calibrate model carm roll.lookup.npz propeller.lookup.npz --held-out other.lookup.npz -o carm.model.npz",
    )(model)
    calibrate.command(
        "scan",
        short_help="Propose the scan that shows the kinematic model's parameters.",
        help="Proposes sweeps of one axis at a time that show the kinematic model's parameters, as an experiment file."
        "\n\nExample:  isocenter calibrate scan carm -o calibration.toml"
        "\n\nThen:  isocenter run calibration.toml -m carm -b lockstep: -o calibration.mf4",
    )(scan)
    calibrate.command(
        "grid",
        short_help="Propose the poses of a roadmapping calibration.",
        help="Proposes a grid of poses over the axes' ranges at which the machine stands, as an experiment file."
        "\n\nExample:  isocenter calibrate grid carm --step 30 -o grid.toml"
        "\n\nThen run it, expose the phantom, and:  isocenter calibrate phantom carm grid_scan --standing -o grid.npz",
    )(grid)


def grid(
    machine_name: MachineArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="Experiment file to write (.toml).")],
    step: Annotated[float, typer.Option("--step", metavar="DEG", help="Between neighbouring poses at most, degrees.")] = 30.0,
    dwell: Annotated[float, typer.Option("--dwell", metavar="S", help="Standstill at each pose.")] = 1.5,
    share: Annotated[float, typer.Option("--share", min=0.05, max=1.0, help="Share of every axis's range to stay in.")] = 0.9,
    pace: Annotated[float, typer.Option("--pace", min=0.01, max=1.0, help="Share of the machine's speed and acceleration.")] = 0.5,
    json_to: JsonOption = None,
) -> None:
    """Write a grid of poses, row by row, there and back."""
    import numpy as np

    from hil.calibration.kinematic.scan_proposal import grid_tour
    from hil.experiments import write_experiment

    for option, value in (("--step", step), ("--dwell", dwell)):
        if not 0.0 < value < np.inf:
            raise UnusableInputError(f"{option} {value:g}: must be a positive number")
    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(out, suffixes=(".toml",))
    tour = grid_tour(machine, np.radians(step), share, pace, dwell)
    seconds = tour.plans(machine)[0].rows / machine.sample_rate_Hz
    write_experiment(tour, machine, out)
    answer.say(f"{out}: {len(tour.stops)} poses, {seconds:.0f} s")
    answer.write({"experiment": out, "poses": len(tour.stops), "seconds": seconds})


def scan(
    machine_name: MachineArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="Experiment file to write (.toml).")],
    sweeps: Annotated[int, typer.Option("--sweeps", metavar="N", min=1, max=20, help="How many sweeps of one axis.")] = 4,
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", help="Exposures a second that will be taken.")] = 7.0,
    share: Annotated[float, typer.Option("--share", min=0.05, max=1.0, help="Share of every axis's range to stay in.")] = 0.9,
    pace: Annotated[float, typer.Option("--pace", min=0.01, max=1.0, help="Share of the machine's speed and acceleration.")] = 0.2,
    json_to: JsonOption = None,
) -> None:
    """Choose, tell, write."""
    import numpy as np

    from hil.calibration.kinematic.nominal_chain import nominal_chain
    from hil.calibration.kinematic.scan_proposal import propose_scan
    from hil.experiments import write_experiment

    if not 0.0 < rate < np.inf:
        raise UnusableInputError(f"--rate {rate:g}: must be a positive number")
    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(out, suffixes=(".toml",))
    proposal = propose_scan(machine, nominal_chain(machine), sweeps, 50, share, pace)
    seconds = proposal.tour.plans(machine)[0].rows / machine.sample_rate_Hz
    write_experiment(proposal.tour, machine, out)
    answer.say(f"{out}: {sweeps} sweeps, {seconds:.0f} s, {seconds * rate:.0f} exposures at {rate:g} a second")
    for first, last in zip(proposal.tour.stops[::2], proposal.tour.stops[1::2], strict=True):
        answer.say(f"  {_stop(first, machine)} to {_stop(last, machine)}")
    answer.say(
        f"predicted pose, rms over the range: {1e3 * proposal.position_sigma_m:.3f} mm and {1e3 * proposal.rotation_sigma_rad:.3f} mrad"
        f" (from the drawing's tolerances {1e3 * proposal.nominal_sigma_m:.1f} mm)"
    )
    answer.say(f"shows {proposal.rank} combinations of {proposal.free} free parameters; kept at nominal: {', '.join(proposal.frozen)}")
    for combination in proposal.null:
        answer.say(f"  not shown: {combination}")
    answer.write(
        {
            "experiment": out,
            "seconds": seconds,
            "stops": proposal.tour.stops,
            "position_sigma_m": proposal.position_sigma_m,
            "rotation_sigma_rad": proposal.rotation_sigma_rad,
            "nominal_sigma_m": proposal.nominal_sigma_m,
            "rank": proposal.rank,
            "null": [dict(each.shares) for each in proposal.null],
            "frozen": proposal.frozen,
        }
    )


def _stop(stop: Mapping[str, float], machine: Machine) -> str:
    return ", ".join(f"{axis} {value / edge_scale(machine, axis):.0f}" for axis, value in stop.items())


def model(
    machine_name: MachineArgument,
    scans: Annotated[
        list[Path], typer.Argument(metavar="SCAN", help="Tables of isocenter calibrate phantom, or scan folders of the phantom.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="MODEL", help="Model to write (.npz).")],
    held_out: Annotated[
        list[Path] | None,
        typer.Option("--held-out", metavar="SCAN", help="Judge the model on this scan, which it is not fitted to; repeat."),
    ] = None,
    freeze: Annotated[list[str] | None, typer.Option("--freeze", metavar="NAME", help="Keep a parameter at nominal; repeat.")] = None,
    need: Annotated[
        list[str] | None, typer.Option("--need", metavar="NAME", help="Refuse scans that cannot show this parameter by itself; repeat.")
    ] = None,
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="Residuals of all scans.")] = None,
    jobs: Annotated[int, typer.Option("--jobs", metavar="N", min=1, help="Processes that look at images.")] = 1,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Fit, tell, write."""
    import numpy as np

    from hil.calibration.kinematic.flexible import clock_lag
    from hil.calibration.kinematic.from_tables import model_from_tables
    from hil.calibration.kinematic.geometric_model import write_model
    from hil.calibration.kinematic.nominal_chain import nominal_chain

    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(out, figure)
    check_page(page)
    for path in (*scans, *(held_out or ())):
        not_an_input(out, path)
    start = nominal_chain(machine)
    unknown = sorted({*(freeze or ()), *(need or ())} - set(start.names))
    if unknown:
        raise UnusableInputError(f"{', '.join(unknown)}: no such parameter; {machine.name} has {', '.join(start.names)}")
    fitted = [_table(path, machine, jobs, answer) for path in scans]
    others = [_table(path, machine, jobs, answer) for path in held_out or ()]
    with working("fitting the model"):
        found, fit = model_from_tables(machine, fitted, freeze or (), [path.name for path in scans])
    _refuse_unseen(fit, need or ())
    _report(answer, fit, start.values)
    lag, known = clock_lag(fit, fitted)
    if abs(lag) > max(STANDARD_ERRORS * known, LEAST_LAG):
        answer.say(
            f"  the images were taken {lag:.3f} of an exposure's period ({known:.3f}) {'later' if lag > 0.0 else 'earlier'} than their"
            " positions say: do the panel's clock and the loop's agree?"
        )
    if fit.unmodelled_m > MISFIT_M:
        answer.say(
            "  the poses do not fit the model: was the phantom moved between scans, did the machine shake, or does more give way than"
            " the machine file says?"
        )
    judged = {}
    for path, table, held in [(p, t, False) for p, t in zip(scans, fitted, strict=True)] + [
        (p, t, True) for p, t in zip(held_out or (), others, strict=True)
    ]:
        rms = {"nominal": _rms(_less(table, None)), "model": _rms(_less(table, found))}
        judged[str(path)] = {"held_out": held, **rms}
        label = f"{path.name} (held out)" if held else path.name
        answer.say(f"  {label}: rms of nominal {_rms_text(rms['nominal'])}; of the model {_rms_text(rms['model'])}")
    write_model(found, out)
    answer.say(f"{out}: model of {len(start.names)} parameters, {fit.rank} combinations fitted")
    if figure is not None:
        _draw(found, [*scans, *(held_out or ())], [*fitted, *others], len(fitted), figure)
        answer.say(f"{figure}: residuals of {len(fitted) + len(others)} scans")
    if page is not None:
        from hil.reports.calibrated import model_page

        every_table = [*fitted, *others]
        left = {"less model": [_less(table, found) for table in every_table], "less nominal": [table.deviation for table in every_table]}
        write_paged(answer, model_page(machine, judged, left, out, answer.said), page)
    answer.write(
        {
            "exposures": sum(len(each.positions) for each in fitted),
            "rank": fit.rank,
            "singular_values": fit.singular_values,
            "null": [dict(each.shares) for each in fit.null],
            "frozen": fit.frozen,
            "chi2": fit.chi2,
            "unmodelled_m": fit.unmodelled_m,
            "clock_lag_periods": {"value": lag, "sigma": known},
            "parameters": {
                name: {"value": value, "nominal": nominal, "sigma": sigma, "unit": unit}
                for name, value, nominal, sigma, unit in zip(
                    start.names, fit.model.values, start.values, np.sqrt(np.diag(fit.covariance)), start.units, strict=True
                )
            },
            "scans": judged,
        }
    )


def _table(path: Path, machine: Machine, jobs: int, answer: Answer) -> LookUp:
    """Return a table from its file, or from the images of a folder."""
    from hil.calibration.use.from_phantom_scan import calibrate_phantom_scan
    from hil.calibration.use.lookup_table import read_look_up
    from hil.imaging.scan_folder import read_scan

    if not path.is_dir():
        table = read_look_up(path)
        table.require(machine)
        return table
    scan = read_scan(path)
    with progress() as bars:
        follow = follower(bars, bars.add_task(path.name, total=len(scan)))
        return calibrate_phantom_scan(machine, scan, jobs=jobs, progress=lambda done, total: follow(done)).table


def _refuse_unseen(fit: FlexibleFit, need: list[str] | tuple[()]) -> None:
    for name in need:
        if name in fit.frozen:
            raise UnusableInputError(
                f"{name}: these scans cannot show it: nothing that it depends on moves; isocenter calibrate scan proposes one"
            )
        for combination in fit.null:
            share = dict(combination.shares)[name]
            if abs(share) > VISIBLE_SHARE:
                raise UnusableInputError(f"{name}: these scans cannot tell it from others: {combination} changes no pose of them")


STANDARD_ERRORS, LEAST_LAG = 5.0, 2e-3
"""A lag is reported from so many of its standard deviations, and from so much of a period, on."""

MISFIT_M = 0.3e-3
"""Scatter of the poses besides the images' noise from which on the model is said not to fit; sweeps at speed shake by less."""

VISIBLE_SHARE = 0.05
"""A parameter with a smaller share in every combination that is not seen is determined by the others."""


def _report(answer: Answer, fit: FlexibleFit, nominal: np.ndarray) -> None:
    import numpy as np

    sigma = np.sqrt(np.diag(fit.covariance))
    answer.say(
        f"{len(fit.residual)} exposures show {fit.rank} combinations of {len(fit.model.names) - len(fit.frozen)} free parameters;"
        f" besides the images' noise poses scatter by {1e3 * fit.unmodelled_m:.3f} mm and {2e3 * fit.unmodelled_m:.3f} mrad"
    )
    for name, unit, value, was, deviation in zip(fit.model.names, fit.model.units, fit.model.values, nominal, sigma, strict=True):
        if name in fit.frozen:
            continue
        scale, label = (1e3, {"m": "mm", "rad": "mrad"}[unit]) if unit in ("m", "rad") else (1.0, unit)
        answer.say(
            f"  {name:26s} {scale * value:12.5g} {label:6s} ({scale * (value - was):+.3g} from nominal), sigma {scale * deviation:.2g}"
        )
    answer.say(f"  kept at nominal: {', '.join(fit.frozen) or 'nothing'}")
    for combination in fit.null:
        answer.say(f"  not seen, left where it was: {combination}")


def _less(table: LookUp, model: GeometricModel | None) -> np.ndarray:
    """Return the phantom-calibrated pose less the model's, or less nominal, (N, 9)."""
    from hil.imaging.nominal import nominal_beam

    if model is None:
        return table.deviation
    beam = nominal_beam(model.machine, table.positions)
    return beam.moved(table.deviation).deviation_from(beam.moved(model.at(table.positions)))


def _rms(difference: np.ndarray) -> dict[str, float]:
    """Return rms of source [m], phantom [m] and rotation [rad] over the exposures."""
    import numpy as np

    square = np.mean(difference**2, axis=0)
    return {name: float(np.sqrt(square[k : k + 3].sum())) for name, k in (("source_m", 0), ("position_m", 3), ("rotation_rad", 6))}


def _rms_text(rms: dict[str, float]) -> str:
    return f"{1e3 * rms['position_m']:.3f} mm, {1e3 * rms['rotation_rad']:.3f} mrad, source {1e3 * rms['source_m']:.3f} mm"


def _draw(found: GeometricModel, paths: list[Path], tables: list[LookUp], fitted: int, path: Path) -> None:
    from hil.figures.geometric_model import residual_figure

    picture = residual_figure(
        [each.name for each in paths],
        [_less(table, None) for table in tables],
        [_less(table, found) for table in tables],
        [k >= fitted for k in range(len(tables))],
    )
    save_figure(picture, path)
