"""Running of every experiment's plans: on which bus, how, and what is reported."""

from __future__ import annotations

import contextlib
import functools
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli.asking import Terminal, by_options
from hil.cli.attend import TellOption, opened, telling
from hil.cli.emulated import EMULATED
from hil.cli.observe import DampingOption, ObserverOption
from hil.cli.options import (
    BusOption,
    EffectsOption,
    FaultsOption,
    ImuOption,
    IoOption,
    QuirksOption,
    RealTimeOption,
    can_be_written,
    keep_earlier,
    load,
    not_an_input,
    read_faults,
    read_quirks,
)
from hil.cli.run_data import DataOption, UntilOption, data_beside, keep_sightings, leave
from hil.cli.run_images import BinningOption, ImageRateOption, ImagesOption, PanelOption, SceneOption, SpoolOption, images_beside
from hil.cli.told_faults import Told
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import EVERY_S, follower, progress
from hil.verbs.observe import live_observer

if TYPE_CHECKING:
    from hil.experiments import Experiment
    from hil.machine import Machine

OutOption = Annotated[
    Path,
    typer.Option(
        "-o",
        "--out",
        metavar="REC",
        help="Recording to write (.mf4 or .csv); of several, each gets its realisation and experiment in its name.",
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed of phases, and in lockstep of the emulator's noise.")]
FrameLogOption = Annotated[Path | None, typer.Option("--frame-log", metavar="FILE", help="Write every CAN frame as candump does (.log).")]
TruthOption = Annotated[Path | None, typer.Option("--truth", metavar="FILE", help="In lockstep: what only the emulator knows (.csv).")]
EmulatedOption = Annotated[
    str, typer.Option("--emulated", metavar="M", help="In lockstep: the machine that is really there, where it was built off its file.")
]
AcceptMarginsOption = Annotated[
    bool, typer.Option("--accept-margins", help="Run a controller that `isocenter machine check` fails; the recording says so.")
]
NoiseOption = Annotated[bool, typer.Option("--noise/--no-noise", help="In lockstep: the emulated sensors' noise.")]


@dataclass(frozen=True)
class RunOptions:
    """Where an experiment is run, on what, and where its recordings go."""

    out: OutOption
    bus: BusOption
    seed: SeedOption = 0
    effects: EffectsOption = None
    faults: FaultsOption = None
    quirk: QuirksOption = None
    imu: ImuOption = ""
    io: IoOption = ""
    emulated: EmulatedOption = ""
    noise: NoiseOption = True
    frame_log: FrameLogOption = None
    truth: TruthOption = None
    real_time: RealTimeOption = True
    accept_margins: AcceptMarginsOption = False
    observer: ObserverOption = None
    damping: DampingOption = 0.0
    images: ImagesOption = None
    scene: SceneOption = "dodecahedron"
    image_rate: ImageRateOption = 7.0
    image_binning: BinningOption = 4
    spool: SpoolOption = None
    panel: PanelOption = ""
    data: DataOption = None
    until: UntilOption = 0.0
    tell: TellOption = False
    json_to: JsonOption = None


def run_and_tell(machine: Machine, experiment: Experiment, run: RunOptions, notes: tuple[str, ...] = ()) -> None:
    """Plan an experiment, run it, record it, say how it went."""
    from hil.bench.audit_trail import events_path
    from hil.bench.margins import accepted_margins
    from hil.bench.open import recording_paths
    from hil.bench.options import BenchOptions
    from hil.terminal.bar import drawn_beside

    plans = experiment.plans(machine)
    answer = Answer(run.json_to)
    for note in dict.fromkeys((*notes, *(note for plan in plans for note in plan.notes))):
        answer.say(note)
    paths = recording_paths(run.out, plans)
    can_be_written(*(path for path in paths if not path.is_file()), run.frame_log, run.truth)  # a file that is there is moved aside
    inputs = [path for path in (run.observer, run.data, run.effects, run.faults) if path is not None]
    for written in (run.frame_log, run.truth):
        if written is not None:
            not_an_input(written, *inputs)
    lockstep = run.bus.startswith("lockstep:")
    if run.emulated and not lockstep:
        raise UnusableInputError("--emulated: only a run on lockstep: emulates; give that machine to `isocenter emulate`")
    if run.faults is not None and not lockstep:
        raise UnusableInputError("--faults: only an emulated machine can have them; give them to `isocenter emulate`, or run on lockstep:")
    if run.quirk and not lockstep:
        raise UnusableInputError("--quirk: only an emulated machine can have them; give them to `isocenter emulate`, or run on lockstep:")
    emulated = _emulated(machine, run)
    faults, quirks = read_faults(run.faults, emulated or machine, lockstep), read_quirks(run.quirk, emulated or machine)
    told = Told.of(faults, machine)
    records: list[dict[str, Any]] = []
    data = data_beside(machine, run.data, run.until, run.observer is not None, run.images, run.image_rate, plans, lockstep)
    with by_options():
        behind = None if data is None else data.behind
        watching = live_observer(run.observer, machine, run.damping, behind, Terminal(answer=answer))
    frames = images_beside(
        machine,
        run.images,
        run.scene,
        run.image_rate,
        run.image_binning,
        run.spool,
        run.panel,
        run.bus,
        paths,
        run.truth,
        answer,
        lockstep,
        run.real_time and not lockstep,
        data,
    )
    accepted = accepted_margins(machine, run.accept_margins, "--accept-margins")
    for failing in accepted:
        answer.say(f"accepted: {failing}")
    with contextlib.ExitStack() as stack:
        stack.callback(told.say, answer)
        if data is not None and run.images is not None:
            stack.callback(keep_sightings, data, run.images)
        truth, rows = stack.enter_context(frames)
        options = BenchOptions(
            *(run.bus, run.imu, run.io, run.seed, run.noise, run.frame_log, truth, emulated, faults, quirks, told.motion, told.events),
            real_time=run.real_time,
            accepted_margins=accepted,
        )
        bench = stack.enter_context(opened(machine, options, plans[0].start_pose, watching))
        stack.enter_context(telling(bench, run.tell))
        with progress(live=lockstep) as bars:
            for plan, path in zip(plans, paths, strict=True):
                if kept := keep_earlier(path):
                    answer.say(kept)
                if not lockstep:
                    answer.say(f"{path}: homing, way and standstill, then {plan.rows / machine.sample_rate_Hz:.0f} s are recorded")
                task = bars.add_task(path.name, total=plan.rows)
                told_of = sys.stderr.isatty() or plan.rows / machine.sample_rate_Hz > EVERY_S
                beside = functools.partial(drawn_beside, rows=plan.rows, name=path.name) if told_of else None
                timing = bench.run(plan, path, follower(bars, task) if lockstep else None, beside, rows)
                bars.update(task, completed=plan.rows)
                said = (*timing.notes, *stepped_over(run, timing.missed))
                for note in said:
                    answer.say(f"{path}: {note}")
                records.append(
                    {
                        "recording": path,
                        "experiment": plan.metadata,
                        "timing": timing.summary(),
                        "notes": said,
                        "judged": timing.judged,
                        "events": events_path(path),
                    }
                )
        scheduling = str(bench.scheduling)
    answer.say(f"{EMULATED if bench.emulated else ''}{machine.name} on {run.bus} ({scheduling})")
    for record in records:
        timing_table = record["timing"]
        line = f"{record['recording']}: {timing_table['ticks']} rows"
        if not lockstep:
            line += (
                f", {timing_table['missed']} ticks missed, {timing_table['unanswered']} unanswered, "
                f"lateness p99 {timing_table['lateness_p99_us']:.0f} us, work time p99 {timing_table['work_time_p99_us']:.0f} us"
            )
        answer.say(line)
    document: dict[str, Any] = {"machine": machine.name, "hash": machine.hash, "bus": run.bus, "scheduler": scheduling}
    document["emulated"] = bench.emulated
    document["recordings"] = records
    document["accepted_margins"] = accepted
    if data is not None and run.images is not None:
        document["calibration"] = leave(data, run.images, answer)
    if quirks:
        document["quirks"] = [quirk.label for quirk in quirks]
    if faults:
        document["faults"] = told.document()
    answer.write(document)
    if judged := [f"{record['recording']}: {line}" for record in records for line in record["judged"]]:
        answer.say("sensors not to be believed: " + "; ".join(judged))
        raise typer.Exit(1)


def stepped_over(run: RunOptions, missed: int) -> tuple[str, ...]:
    """Return a note on lost ticks for an observer: an emulated machine stood still meanwhile; a real one moves on."""
    from hil.emulated.card import find

    if run.observer is None or not missed or find(run.bus) is None:
        return ()
    return (f'the observer stepped over {missed} lost ticks, in which the emulated machine waited; put overrun = "wait" into [timing]',)


def _emulated(machine: Machine, run: RunOptions) -> Machine | None:
    """Return what is emulated, where it is not the machine's own file.

    Raises
    ------
    UnusableInputError
        Another machine altogether.
    """
    if not run.emulated and run.effects is None:
        return None
    from hil.machine.effects_file import read_effects_file

    built = load(run.emulated) if run.emulated else machine
    if built.axes != machine.axes or built.sample_rate_Hz != machine.sample_rate_Hz:
        raise UnusableInputError(
            f"--emulated {run.emulated}: has {', '.join(built.axes)} at {built.sample_rate_Hz:g} Hz,"
            f" {machine.name} has {', '.join(machine.axes)} at {machine.sample_rate_Hz:g} Hz"
        )
    return built if run.effects is None else built.with_effects(read_effects_file(run.effects, built))
