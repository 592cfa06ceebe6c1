"""isocenter run EXPERIMENT: multisine, scan, jog, static, or an experiment file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from typer.core import TyperGroup

from hil.cli.design import designed
from hil.cli.options import MachineOption, NominalPeriodOption, PoseOption, edge_scale, load, parse_band, parse_pose, parse_whole_numbers
from hil.cli.running import RunOptions, run_and_tell
from hil.cli.shared import takes

if TYPE_CHECKING:
    from typer._click.core import Command, Context  # Typer's own copy of Click: for annotations only

    from controllers.excitation_lines import Band
    from hil.experiments import Experiment
    from hil.machine import Machine

Choice = TypeVar("Choice", bound=str)


class ExperimentGroup(TyperGroup):
    """A group in which an experiment file may take the place of a command's name."""

    def resolve_command(self, ctx: Context, args: list[str]) -> tuple[str | None, Command | None, list[str]]:
        """Read `run FILE.toml ...` as `run file FILE.toml ...`."""
        if args and (args[0].endswith(".toml") or "/" in args[0]):
            args = ["file", *args]
        return super().resolve_command(ctx, args)


STOPPING = (
    "\n\nCtrl-C stops it: quick stop, brakes closed and proven, voltage off; the rows so far are kept, and the time to standstill is"
    " printed. Ctrl-C again does not shorten a stop."
)

app = typer.Typer(
    cls=ExperimentGroup,
    no_args_is_help=True,
    short_help="Run an experiment in closed loop and record it.",
    help="Run an experiment in closed loop and record it: multisine, scan, jog, static, or an experiment file (.toml)."
    f"{STOPPING}"
    "\n\nExample:  isocenter run multisine --machine carm --bus lockstep: --pose roll=30 -o run.mf4",
)


@app.command(
    short_help="Random-phase multisine under jog.",
    help="Random-phase multisine under jog: what frequency responses are identified from."
    f"{STOPPING}"
    "\n\nExample:  isocenter run multisine -m carm -b lockstep: --periods 4 --realisations 3 -o run.mf4"
    "\n\nThen, dense where that response changes:"
    "  isocenter run multisine -m carm -b lockstep: --design carm.frf.npz --period 40 -o dense.mf4",
)
@takes(RunOptions)
def multisine(
    machine_name: MachineOption,
    run: RunOptions,
    pose: PoseOption = "",
    axes: Annotated[str, typer.Option("--axes", metavar="A,B", help="Excited axes; all unless given.")] = "",
    experiments: Annotated[str, typer.Option("--experiments", help="orthogonal (all axes at once, mixed) or single.")] = "orthogonal",
    band: Annotated[str, typer.Option("--band", metavar="LOW:HIGH", help="Excited band [Hz].")] = "0.15:40",
    lines: Annotated[str, typer.Option("--lines", metavar="N,N,...", help="Excited lines instead of a band.")] = "",
    every_line: Annotated[bool, typer.Option("--every-line", help="Even lines too; forfeits the odd/even split.")] = False,
    design: Annotated[
        list[Path] | None,
        typer.Option(
            "--design", metavar="FRF", help="Lines, weights and amplitude from an identified response; repeat it for several poses."
        ),
    ] = None,
    design_lines: Annotated[int, typer.Option("--design-lines", metavar="N", help="How many lines --design sets.")] = 120,
    amplitude: Annotated[
        float | None,
        typer.Option("--amplitude", help="Rms of the excitation, in the drive's unit; 0.8 unless given or told by --design."),
    ] = None,
    period: NominalPeriodOption = 20.0,
    periods: Annotated[int, typer.Option("--periods", help="Periods kept.")] = 10,
    settle_periods: Annotated[int, typer.Option("--settle-periods", help="Periods before them, for transients.")] = 1,
    realisations: Annotated[int, typer.Option("--realisations", help="Draws of the phases.")] = 1,
    phases: Annotated[str, typer.Option("--phases", help="random, or optimised for a low crest factor.")] = "random",
    jog_amplitude: Annotated[float, typer.Option("--jog", help="Jog amplitude in degrees (mm); 0 switches it off.")] = 2.0,
    jog_frequency: Annotated[
        float | None, typer.Option("--jog-frequency", metavar="HZ", help="Jog frequency; line 1 of the period unless given.")
    ] = None,
    jog_turn: Annotated[
        float,
        typer.Option("--jog-turn", metavar="SHARE", help="Share of each way that the jog's turn takes, constant speed between; 1: sine."),
    ] = 1.0,
) -> None:
    """Plan and run."""
    from hil.experiments import Jog, Multisine

    machine = load(machine_name)
    scale = edge_scale(machine, machine.axes[0])
    jog = None
    if jog_amplitude:
        line = 1 if jog_frequency is None else None
        jog = Jog(amplitude_rad=jog_amplitude * scale, line=line, frequency_Hz=jog_frequency, turn_share=jog_turn)
    chosen: Any = _lines(band, lines, every_line)
    weights = None
    rms: float | Mapping[str, float] = Multisine.amplitude_A  # the experiment's own default
    notes: tuple[str, ...] = ()
    if design:
        if lines:
            raise typer.BadParameter("--lines and --design: lines are either given or designed")
        plan = designed(
            design,
            machine,
            _names(axes),
            count=design_lines,
            band_Hz=(chosen.low_Hz, chosen.high_Hz),
            period_s=period,
            odd=not every_line,
            jog_line=None if jog is None else jog.on_line(machine, round(period * machine.sample_rate_Hz)),
        )
        chosen, weights, notes = plan.lines, plan.weights, plan.notes
        rms = rms if plan.amplitude is None else plan.amplitude
    experiment = Multisine(
        pose=parse_pose(pose, machine),
        axes=_names(axes),
        experiments=_one_of(experiments, ("orthogonal", "single"), "--experiments"),
        lines=chosen,
        weights=weights,
        amplitude_A=rms if amplitude is None else amplitude,
        period_s=period,
        periods=periods,
        settle_periods=settle_periods,
        realisations=realisations,
        phases=_one_of(phases, ("random", "optimised"), "--phases"),
        jog=jog,
        seed=run.seed,
    )
    run_and_tell(machine, experiment, run, notes)


@app.command(
    short_help="A sweep of one axis at constant speed.",
    help="A jerk-limited sweep of one axis at constant speed, as an acquisition makes it."
    f"{STOPPING}"
    "\n\nExample:  isocenter run scan -m carm -b lockstep: --axis roll --from -90 --to 90 --speed 30 -o scan.mf4",
)
@takes(RunOptions)
def scan(
    machine_name: MachineOption,
    run: RunOptions,
    axis: Annotated[str, typer.Option("--axis", help="Axis that sweeps.")],
    start: Annotated[float, typer.Option("--from", help="Start, degrees (mm).")],
    stop: Annotated[float, typer.Option("--to", help="End, degrees (mm).")],
    speed: Annotated[float, typer.Option("--speed", help="Speed of the constant part, degrees/s (mm/s).")] = 30.0,
    sweeps: Annotated[int, typer.Option("--sweeps", help="1: there; 2: there and back; and so on.")] = 1,
    dwell: Annotated[float, typer.Option("--dwell", metavar="S", help="Standstill before and after each sweep.")] = 1.0,
    shaper: Annotated[Path | None, typer.Option("--shaper", metavar="FILE", help="Shape the reference: a file of isocenter shape.")] = None,
    pose: PoseOption = "",
) -> None:
    """Plan and run."""
    from hil.experiments import Scan

    machine = load(machine_name)
    _known_axis(axis, machine)
    scale = edge_scale(machine, axis)
    experiment: Experiment = Scan(axis, start * scale, stop * scale, speed * scale, parse_pose(pose, machine), dwell, sweeps)
    if shaper is not None:
        from hil.shaping.plans import Shaped
        from hil.shaping.shaper_file import read_shaper

        experiment = Shaped(experiment, read_shaper(shaper))
    run_and_tell(machine, experiment, run)


@app.command(help=f"Sinusoidal reference alone.{STOPPING}\n\nExample:  isocenter run jog -m carm -b lockstep: --amplitude 2 -o jog.mf4")
@takes(RunOptions)
def jog(
    machine_name: MachineOption,
    run: RunOptions,
    amplitude: Annotated[float, typer.Option("--amplitude", help="Degrees (mm).")] = 2.0,
    axes: Annotated[str, typer.Option("--axes", metavar="A,B", help="Axes that jog; all unless given.")] = "",
    period: NominalPeriodOption = 20.0,
    periods: Annotated[int, typer.Option("--periods", help="Periods kept.")] = 2,
    pose: PoseOption = "",
) -> None:
    """Plan and run."""
    from hil.experiments import Jog, JogOnly

    machine = load(machine_name)
    shape = Jog(amplitude_rad=amplitude * edge_scale(machine, machine.axes[0]), line=1, axes=_names(axes))
    experiment = JogOnly(jog=shape, pose=parse_pose(pose, machine), period_s=period, periods=periods)
    run_and_tell(machine, experiment, run)


@app.command(
    help=f"Hold a pose: noise, drift, holding effort.{STOPPING}"
    "\n\nExample:  isocenter run static -m carm -b lockstep: --seconds 10 -o still.mf4"
)
@takes(RunOptions)
def static(
    machine_name: MachineOption,
    run: RunOptions,
    seconds: Annotated[float, typer.Option("--seconds", help="How long.")] = 10.0,
    pose: PoseOption = "",
) -> None:
    """Plan and run."""
    from hil.experiments import Static

    machine = load(machine_name)
    run_and_tell(machine, Static(seconds, parse_pose(pose, machine)), run)


@app.command(
    "file", help=f"An experiment from its file.{STOPPING}\n\nExample:  isocenter run separate.toml -m carm -b lockstep: -o separate.mf4"
)
@takes(RunOptions)
def from_file(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="Experiment file (TOML).")],
    machine_name: MachineOption,
    run: RunOptions,
) -> None:
    """Plan and run."""
    from hil.experiments import read_experiment

    machine = load(machine_name)
    run_and_tell(machine, read_experiment(path, machine), run)


def _names(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _known_axis(axis: str, machine: Machine) -> None:
    if axis not in machine.axes:
        raise typer.BadParameter(f"--axis {axis}: {machine.name} has {', '.join(machine.axes)}")


def _one_of(value: str, allowed: tuple[Choice, ...], option: str) -> Choice:
    for choice in allowed:
        if value == choice:
            return choice
    raise typer.BadParameter(f"{option} {value}: must be {' or '.join(allowed)}")


def _lines(band: str, lines: str, every_line: bool) -> tuple[int, ...] | Band:
    from controllers.excitation_lines import Band

    return parse_whole_numbers("--lines", lines) if lines else Band(*parse_band("--band", band), odd=not every_line)
