"""isocenter diagnose: where simulation and recordings differ, and which physics was left out."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.emulated import say_emulated
from hil.cli.options import MachineArgument, folder_can_be_written, load
from hil.errors import RecordingError, UnusableInputError
from hil.terminal.output import Answer, JsonOption, plain
from hil.terminal.progress import progress

if TYPE_CHECKING:
    from hil.diagnosis.audit.audit import Audit
    from hil.diagnosis.result import Diagnosis, Finding
    from hil.diagnosis.verdict.values import Outcome
    from hil.machine import Machine
    from hil.recording import Recording

STEPS = ("audit", "seen")
"""After which a diagnosis can stop."""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Which physics the simulation leaves out.",
        help="Where the simulation of a machine and its recordings differ, which physics was left out, and how sure that is."
        " Repeats of the same experiment give the noise: record at least three."
        "\n\nExample:  isocenter diagnose carm rep1.mf4 rep2.mf4 rep3.mf4 --held-out other.mf4 -o diagnosis",
    )(diagnose)


def diagnose(
    machine_name: MachineArgument,
    recordings: Annotated[list[Path], typer.Argument(metavar="REC...", help="Recordings (.mf4, .csv, .parquet, .mcap, .mat) to explain.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the answer; made if it is not there.")],
    held_out: Annotated[
        list[Path] | None, typer.Option("--held-out", metavar="REC...", help="Recordings to judge by; nothing is fitted to them.")
    ] = None,
    known: Annotated[
        Path | None,
        typer.Option("--known", metavar="FILE", help="Effects file (TOML) of physics that the machine has: simulated, and not sought."),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", metavar="N", min=1, help="Processors that free runs may use; all by default. Same answer."),
    ] = None,
    stop_after: Annotated[
        str | None,
        typer.Option("--stop-after", metavar="STEP", help="`audit`: controllers and encoders alone. `seen`: also what each joint lacks."),
    ] = None,
    freely: Annotated[
        bool,
        typer.Option(
            "--free-runs",
            help="Judge by free runs of the closed loop, or not at all. They need repeats, recorded by the file's controller.",
        ),
    ] = False,
    json_to: JsonOption = None,
) -> None:
    """Diagnose and write DIR."""
    from hil.diagnosis.diagnose import audit_recordings, diagnose_audited
    from hil.diagnosis.files import write_answer

    if stop_after not in (None, *STEPS):
        raise UnusableInputError(f"--stop-after {stop_after}: is no step; {' or '.join(STEPS)} would be right")
    answer = Answer(json_to)
    machine = load(machine_name, known)
    folder_can_be_written(out)
    _check_apart(recordings, held_out or [])
    train = _read(recordings, machine)
    held = _read(held_out or [], machine, train)
    say_emulated(answer, {**train, **held})
    audited = audit_recordings(machine, train, held)
    if stop_after is not None:
        _stopped(stop_after, answer, machine, train, audited)
        return
    with progress() as bars:
        task = bars.add_task("reading", total=None)

        def report(what: str, share: float) -> None:
            bars.update(task, description=what)  # shares are no work that was counted

        def first(diagnosis: Diagnosis) -> None:
            write_answer(diagnosis, out)
            bars.print(f"first answer: {_found(diagnosis.findings)} (provisional; {diagnosis.seconds:.1f} s)", style="dim")

        outcome = diagnose_audited(machine, train, held, audited, freely=freely, jobs=jobs, report=report, first=first)
    _finish(answer, outcome, machine, out, {**train, **held})


def _finish(answer: Answer, outcome: Outcome, machine: Machine, out: Path, recordings: Mapping[str, Recording]) -> None:
    """Write and say the answer; leave with status 1 where the recordings do not give one."""
    from hil.diagnosis.files import write_diagnosis
    from hil.reports.made_from import was_emulated

    write_diagnosis(outcome, machine, out, was_emulated(recordings.values()))
    _say(answer, outcome, out)
    answer.write(plain(outcome.diagnosis.document()))
    if outcome.diagnosis.verdict in ("misconfigured", "inconclusive"):
        raise typer.Exit(1)


def _stopped(step: str, answer: Answer, machine: Machine, recordings: Mapping[str, Recording], audited: Audit) -> None:
    """Say what the first steps show."""
    import numpy as np

    from hil.diagnosis.residuals.residuals import residuals_of

    for said in [
        *(fault.said for fault in audited.faults),
        *(axis.said for axis in audited.axes),
        *(pair.said for pair in audited.sensors),
    ]:
        answer.say(said)
    if not audited.axes and not audited.faults:
        rate = f"{machine.sample_rate_Hz:g} Hz"
        answer.say(f"no recording has reference, position and command of an axis at {rate}: no controller is audited")
    document: dict[str, object] = {"audit": audited.document()}
    if step == "seen" and not audited.faults:
        units = {drive.joint: "N" if drive.joint in _sliding(machine) else "Nm" for drive in machine.plant.drives}
        missing = residuals_of(machine, recordings).missing()
        for each in missing:
            rms = [float(np.sqrt(np.mean(values**2))) for values in (each.given, each.missing)]
            said = f"{each.recording}, {each.joint}: effort {rms[0]:.3g} {units[each.joint]} rms,"
            answer.say(f"{said} of which the motion by the machine file lacks {rms[1]:.3g} {units[each.joint]} ({each.share:.0%})")
        document["seen"] = [
            {"recording": each.recording, "joint": each.joint, "unit": units[each.joint], "missing_share": each.share} for each in missing
        ]
    answer.write(plain(document))
    if audited.faults or audited.wrong:
        raise typer.Exit(1)


def _sliding(machine: Machine) -> set[str]:
    return {joint.name for joint in machine.plant.tree.joints if joint.kind == "prismatic"}


def _check_apart(fitted_to: list[Path], held_out: list[Path]) -> None:
    """Raise RecordingError where one file is given more than once.

    A copy shows no noise between repeats, and nothing is held out of a fit to it.
    """
    files = [path.resolve() for path in (*fitted_to, *held_out)]
    for number, path in enumerate((*fitted_to, *held_out)):
        earlier = files.index(files[number])
        if earlier < len(fitted_to) <= number:
            raise RecordingError(f"{path}: is given to fit to and as --held-out; hold out another recording")
        if earlier < number:
            raise RecordingError(f"{path}: is given twice; once is enough")


def _read(paths: list[Path], machine: Machine, taken: Collection[str] = ()) -> dict[str, Recording]:
    """Read recordings by their file's name without its suffix; by their path where another one has that name."""
    from hil.diagnosis.diagnose import check_axes
    from hil.recording import read_recording
    from hil.simulation import in_effort

    found: dict[str, Recording] = {}
    for path in paths:
        name = path.stem if path.stem not in found and path.stem not in taken else str(path)
        found[name] = in_effort(read_recording(path, machine), machine)
        check_axes(path, found[name], machine)
    return found


def _found(findings: Sequence[Finding]) -> str:
    """Return effects with their numbers, on one line."""
    words = []
    for finding in findings:
        numbers = ", ".join(
            f"{name} = {e.value:.4g}{' ' + e.unit if e.unit else ''} ({e.ci95[0]:.4g} to {e.ci95[1]:.4g})"
            for name, e in finding.parameters.items()
        )
        words.append(f"{finding.name}: {numbers}")
    return "; ".join(words) or "no effect"


def _say(answer: Answer, outcome: Outcome, out: Path) -> None:
    from hil.diagnosis.report.tables import how_sure
    from hil.diagnosis.verdict.answer import NEXT_EXPERIMENT

    diagnosis = outcome.diagnosis
    answer.say(f"{diagnosis.verdict}: {diagnosis.reason}")
    if diagnosis.known:
        answer.say(f"  known: {', '.join(str(one.effect) for one in diagnosis.known)}")
    for finding in diagnosis.findings:
        answer.say(f"  {finding.name}: confidence {finding.confidence:.2f}; {_found([finding]).split(': ', 1)[1]}")
    if diagnosis.findings:
        answer.say(f"  how sure: {how_sure(diagnosis)}")
    if errors := _errors(diagnosis):
        answer.say(errors)
    if outcome.proposal is not None:
        answer.say(f"  {outcome.proposal.said(str(out / NEXT_EXPERIMENT))}")
    answer.say(f"{out}: report.html, diagnosis.json, effects.toml, machine.toml ({diagnosis.seconds:.1f} s)")


def _errors(diagnosis: Diagnosis) -> str:
    """Return how far every stage is from the recordings: in units of noise, or where that is not known as a share of what moves."""
    fit = diagnosis.fit
    judged, where = (fit.train, "training") if fit.held_out is None else (fit.held_out, "held-out")
    values = {"nominal": judged.nominal, "re-tuned": judged.retuned, "engineer's fit": judged.baseline, "extended": judged.extended}
    if diagnosis.noise != "assumed":
        shown = ", ".join(f"{name} {value:.3g}" for name, value in values.items() if value is not None)
        return f"E, misfit in units of noise, {where}: {shown}" if shown else ""
    shares = {}
    for (name, value), stage in zip(values.items(), ("nominal", "retuned", "baseline", "extended"), strict=True):
        each = [getattr(channel, stage) for channel in fit.channels.values()]
        if value is not None and each and None not in each:
            shares[name] = math.hypot(*each) / math.sqrt(len(each))
    return (
        f"error as a share of what moves, {where}: " + ", ".join(f"{name} {share:.3g}" for name, share in shares.items()) if shares else ""
    )
