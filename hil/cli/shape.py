"""isocenter shape: reference shapers designed and judged."""

from __future__ import annotations

import csv
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli.emulated import EMULATED
from hil.cli.options import (
    EffectsOption,
    MachineArgument,
    PoseOption,
    can_be_written,
    edge_scale,
    load,
    not_an_input,
    parse_band,
    parse_pose,
    parse_whole_numbers,
)
from hil.cli.paged import PageOption, check_page, write_paged
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import working

if TYPE_CHECKING:
    from hil.shaping.aim import Aim
    from hil.shaping.choice import ShaperChoice
    from hil.shaping.shaper_design import Design


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Design and judge a reference shaper.",
        help="Design reference shapers for one axis of a machine, judge them, and write the recommended one."
        "\n\nFor a sweep unless --period says that the scan repeats. Designed from the machine file's closed loop at a pose, at several "
        "with --schedule, or from an identified frequency response with --frf."
        "\n\n--also shortest searches the shortest delay with one tap fewer; dc, zpetc and zmetc invert the path's zeros on the last tap, "
        "those that cannot be inverted by their DC gain, without phase error, or without magnitude error."
        "\n\nExit status: 0, the shaper that was written is fit to run; 1, it was written, but something is against it; 2, none was."
        "\n\nExample:  isocenter shape carm --axis roll -o roll.shaper.npz",
    )(shape)


def shape(
    machine_name: MachineArgument,
    axis: Annotated[str, typer.Option("--axis", help="Axis whose reference is shaped.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="SHAPER", help="Where to write the shaper (.npz).")],
    pose: PoseOption = "",
    period: Annotated[float, typer.Option("--period", metavar="S", help="Period of a scan that repeats; 0 for a sweep.")] = 0.0,
    harmonics: Annotated[str, typer.Option("--harmonics", metavar="N,N,...", help="Of the period: tracked without error.")] = "1,3,5",
    longest: Annotated[
        float, typer.Option("--longest", metavar="S", help="Longest transient; 0.6 s for a sweep, one period otherwise.")
    ] = 0.0,
    schedule: Annotated[str, typer.Option("--schedule", metavar="AXIS", help="Design over the range of this axis and interpolate.")] = "",
    output: Annotated[str, typer.Option("--output", help="What shall track: link, detector or motor.")] = "link",
    frf: Annotated[Path | None, typer.Option("--frf", metavar="FRF", help="Design from an identified frequency response.")] = None,
    quiet: Annotated[str, typer.Option("--quiet", metavar="LOW:HIGH", help="Band [Hz] that the quiet design passes least in.")] = "4:20",
    also: Annotated[
        str, typer.Option("--also", metavar="NAME,...", help="Designs beside the usual ones: shortest, dc, zpetc, zmetc.")
    ] = "",
    take: Annotated[str, typer.Option("--take", metavar="NAME", help="Write this design instead of the recommended one.")] = "",
    table: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Verdicts as CSV.")] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", metavar="PNG", help="Taps, frequency responses, map of delays, before and after in time.")
    ] = None,
    effects: EffectsOption = None,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Print one line per design, the recommended one first."""
    from hil.errors import UnusableInputError
    from hil.identification import read_frf
    from hil.shaping.choice import choose_shaper
    from hil.shaping.in_time import after_step, in_time_lines, settled
    from hil.shaping.report import design_lines, left_out_lines, outside_lines
    from hil.shaping.shaper_file import write_shaper

    machine = load(machine_name, effects)
    for option, name in (("--axis", axis), ("--schedule", schedule)):
        if name not in machine.axes and (name or option == "--axis"):
            raise UnusableInputError(f"{option} {name}: {machine.name} has {', '.join(machine.axes)}")
    if frf is not None and (schedule or pose):
        raise UnusableInputError("--frf: a frequency response is of one pose; leave out --schedule and --pose")
    answer = Answer(json_to)
    if frf is not None:
        not_an_input(out, frf)
    can_be_written(out, suffixes=(".npz",))
    can_be_written(figure, table)
    check_page(page)
    aim = _aim(period, harmonics, longest)
    band, at = parse_band("--quiet", quiet), parse_pose(pose, machine)
    response = None if frf is None else read_frf(frf)
    further = [name.strip() for name in also.split(",") if name.strip()]
    with working("designing"):
        choice = choose_shaper(machine, axis, pose=at, frf=response, aim=aim, schedule=schedule, output=output, quiet_Hz=band, also=further)
    choice = choice.named(take) if take else choice
    source = f"{EMULATED if response is not None and response.emulated else ''}{_source(choice, frf)}"
    choice = replace(choice, notes={**choice.notes, "source": source})
    candidates, designs, chosen, subjects = choice.candidates, choice.designs, choice.chosen, choice.subjects.each
    answer.say(_sentence(designs[0], chosen, axis, machine.name))
    answer.say(f"{aim.kind} of {axis}, from {source}")
    verdicts = [asdict(design.verdict) for design in designs]
    write_shaper(choice.file, out)
    rate = machine.sample_rate_Hz
    in_time = {each.name: after_step(subjects[0].dynamics, each.filters[0], rate) for each in (candidates.named("none"), chosen)}
    for line in (*design_lines(candidates, chosen), *left_out_lines(chosen)):
        answer.say(line)
    for line in in_time_lines(in_time["none"], in_time[chosen.name], chosen.name):
        answer.say(line)
    for line in outside_lines(choice.outside):
        answer.say(line)
    answer.say(f"the quiet design keeps {band[0]:g} to {band[1]:g} Hz low; modes are sought over the whole band of the loop")
    answer.say(f"{out}: {chosen.name}, {len(chosen.filters[0].gains)} taps, {len(subjects)} pose{'s' if len(subjects) > 1 else ''}")
    if table is not None:
        _write_csv([design.verdict.row for design in designs], table)
        answer.say(f"{table}: verdicts")
    if figure is not None:
        from hil.figures.shapers import design_figure

        save_figure(design_figure(designs, subjects, aim, rate, in_time, f"{axis} of {machine.name}, {source}"), figure)
        answer.say(f"{figure}: figure")
    if page is not None:
        from hil.reports.shaped import shaped_page

        sentence, facts = _sentence(designs[0], chosen, axis, machine.name), {"Aim": aim.kind, "From": source}
        write_paged(answer, shaped_page(machine, axis, sentence, candidates, chosen, subjects, in_time, out, facts), page)
    document: dict[str, Any] = {
        "shaper": out,
        "chosen": chosen.name,
        "recommended": designs[0].name,
        "fit": not chosen.verdict.against,
        **choice.notes,
    }
    before_s, after_s = settled(in_time["none"], in_time[chosen.name])
    document["in_time"] = {
        label: {"left": each.left, "settled_s": settled_s, "overshoot": each.overshoot, "ramp_lag_s": each.ramp_lag_s}
        for label, each, settled_s in (("without", in_time["none"], before_s), ("shaped", in_time[chosen.name], after_s))
    }
    document["left_out"] = [vars(each) for each in choice.outside]
    answer.write(document | {"designs": verdicts, "refused": candidates.refused, "not_simulated": candidates.not_simulated})
    if chosen.verdict.against:
        raise typer.Exit(1)


def _sentence(recommended: Design, chosen: Design, axis: str, machine: str) -> str:
    """Return the answer in a sentence."""
    against = chosen.verdict.against
    if against and chosen is recommended:
        return f"No design for {axis} of {machine} is fit to run: the best is {chosen.name}, and against it is: {against}."
    if against:
        return f"{chosen.name} is not fit to run on {axis} of {machine}: {against}. Recommended is {recommended.name}."
    residual = chosen.verdict.residual
    less = f"leaves {100.0 * chosen.verdict.vibration_at_10:.2g} % of the linear loop's vibration with modes 10 % off"
    if residual is not None:
        low, high = (f"{share:.0f}" if share >= 10.0 else f"{share:.2g}" for share in (100.0 * residual.low, 100.0 * residual.high))
        less = f"leaves {low} to {high} % of the vibration, as simulated,"
    beside = "" if chosen is recommended else f"; recommended is {recommended.name}"
    return f"{chosen.name} for {axis} of {machine} {less} and takes {chosen.verdict.transient_s:.3f} s{beside}."


def _aim(period: float, harmonics: str, longest: float) -> Aim:
    from hil.shaping.aim import periodic, sweep

    if period == 0.0:
        return sweep(longest) if longest else sweep()
    return periodic(period, parse_whole_numbers("--harmonics", harmonics), longest or None)


def _source(choice: ShaperChoice, frf: Path | None) -> str:
    """Return in words what the shapers are designed for, positions in degrees (mm)."""
    machine, subjects = choice.machine, choice.subjects
    if subjects.poses is None:
        return f"{frf}, fitted to {subjects.fit_error:.2%}"
    poses = [[value / edge_scale(machine, name) for name, value in zip(machine.axes, pose, strict=True)] for pose in subjects.poses]
    if not subjects.schedule:
        where = ", ".join(f"{name} {value:g}" for name, value in zip(machine.axes, poses[0], strict=True))
        return f"the machine file's closed loop at {where}"
    low, high = (poses[k][machine.axis_index(subjects.schedule)] for k in (0, -1))
    return f"the machine file's closed loop at {len(poses)} poses, {subjects.schedule} {low:g} to {high:g}"


def _write_csv(rows: list[dict[str, str | float]], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
