"""One run per fault of the table, in lockstep, one after the other: what was said, what moved, what is kept."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, Literal

import numpy as np

from drivers.errors import KEEP_AWAY
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.bench.signals import StopRequest
from hil.errors import RecordingError, UnusableInputError, in_one_line
from hil.faults.budget import BudgetUse, budget_use, standing
from hil.faults.claims import Witness, contradictions
from hil.faults.motion import Motion, MotionName, motion_of
from hil.faults.trials import FaultTrial
from hil.machine import Machine
from hil.machine.faults_file import faults_text
from hil.recording import Recording, read_recording
from hil.terminal.output import plain
from hil.version import software_version
from virtual_bus.faults.fault import FaultSetting
from virtual_bus.faults.motion_log import MotionLog
from virtual_bus.faults.outcome import AxisOutcome, FaultOutcome, outcome_of
from virtual_bus.faults.schedule import FaultEvent

OUTCOMES = "outcomes.jsonl"
GIVEN_UP = "was given up"
PROCESSOR_LIMIT_S = 120.0
"""Processor time after which a run counts as one that does not end: forty times what one takes."""
PACKAGES = ("controllers", "drivers", "hil/bench", "hil/faults", "hil/recording", "virtual_bus")
"""What a run with a fault goes through."""

Verdict = Literal["stopped", "noted", "within tolerance", "unnoticed", "cannot be held", "not at rest", "never began", "did not end"]


@dataclass(frozen=True)
class TrialOutcome:
    """What became of one fault.

    Parameters
    ----------
    name, kind, at, group, during : of the trial
    verdict : str
        "stopped": the run ended with an error and everything is at rest. "noted": it went on and said something of it. "within tolerance":
        it ended as if nothing had been, and every position of its recording is that of a run without the fault, up to the tolerance of
        `[judging.encoders]`; where nothing is recorded: it ended where such a run ends, had gone no further, and knows where it stands.
        "unnoticed": it ended as if nothing had been, and is not that.
        "cannot be held": brake and drive are both lost, the emergency stop was named, and nothing drives it. "not at rest": something
        still moves, or has moved without a stop. "never began": the run ended before the fault's time. "did not end".
    exit_status : int
        Of the command `run`.
    said : str
        Its last line, and its notes.
    stopping : tuple of str
        What went wrong in the stop itself.
    rows : int
        Rows of the recording that are kept, of `planned`.
    planned : int
    onset_s : float
        Machine time of the fault, NaN: it never began.
    rest_s : float
        From there to rest of every axis, NaN: not at rest.
    travel : float
        Of the axis that swept, from there to rest or to the end of the watch [rad or m].
    ending : str
        Of that axis: what holds it.
    watched_s : float
        How long the truth was watched after the fault.
    axes : tuple of AxisOutcome
    budget : BudgetUse, optional
        Of the axis that swept; none where the run was not stopped, or the machine file states none.
    contradicted : tuple of str
        Claims of `said` that the truth contradicts.
    processor_s : float
        That the run took.
    """

    name: str
    kind: str
    at: str
    group: str
    during: str
    verdict: Verdict
    exit_status: int
    said: str
    stopping: tuple[str, ...]
    rows: int
    planned: int
    onset_s: float
    rest_s: float
    travel: float
    ending: str
    watched_s: float
    axes: tuple[AxisOutcome, ...]
    budget: BudgetUse | None
    contradicted: tuple[str, ...]
    processor_s: float


class _EndlessError(BaseException):
    """A run has taken more processor time than it may; no `except Exception` on its way may keep it."""


def check_faults(
    machine: Machine,
    axis: str,
    table: Sequence[FaultTrial],
    folder: Path,
    progress: Callable[[int, TrialOutcome], None] | None = None,
    motion: MotionName = "scan",
) -> list[TrialOutcome]:
    """Run every trial, and keep each outcome in the folder as soon as it is there; those that are there already are not run again.

    Parameters
    ----------
    machine : Machine
    axis : str
        That moves.
    table : sequence of FaultTrial
    folder : Path
        Exists; `outcomes.jsonl` grows in it.
    progress : callable, optional
        Called with the number of rows done and the newest.
    motion : str
        What moves the axis, as `trials` was told.
    """
    kept_path = folder / OUTCOMES
    kept = _kept(kept_path)
    made = motion_of(machine, axis, motion)
    outcomes = []
    for number, trial in enumerate(table, start=1):
        key = _key(machine, axis, trial, motion)
        outcome = kept.get(key)
        if outcome is None:
            outcome = run_trial(machine, axis, trial, made)
            _keep(kept_path, json.dumps({"key": key, **_as_json(outcome)}, ensure_ascii=False))
        outcomes.append(outcome)
        if progress is not None:
            progress(number, outcome)
    return outcomes


def run_trial(machine: Machine, axis: str, trial: FaultTrial, motion: Motion) -> TrialOutcome:
    """Run one trial.

    Raises
    ------
    LoopAbortedError
        The user asked to stop; of this trial nothing is kept.
    """
    began_s = time.process_time()
    run = _run(machine, trial.settings, motion)
    onsets = [event.time_s for event in run.events if event.begins]
    onset_s = min(max(onsets), float(run.motion.time_s[-1])) if onsets and len(run.motion) else math.nan
    stands = [standing(machine, each) for each in machine.axes]
    outcome = outcome_of(run.motion, onset_s, stands) if onsets and len(run.motion) else None
    complete = len(onsets) == len(trial.settings) or run.stopped
    verdict = _verdict(trial, run, outcome, complete=complete)
    if verdict == "unnoticed" and _as_sound(machine, axis, motion, run.positions):
        verdict = "within tolerance"
    said, begun = "; ".join(run.lines), [event.label.partition(" at ")[0] for event in run.events if event.begins]
    assert machine.bus is not None  # a machine without one has no faults
    counts = [scaling.position_resolution for scaling in machine.bus.scalings]
    witness = Witness(run.motion, run.said_row, stands, counts, begun, run.rows, run.since_stop_s)
    return TrialOutcome(
        trial.name,
        trial.kind,
        trial.at,
        trial.group,
        trial.during,
        verdict,
        run.status,
        said,
        run.troubles,
        run.rows,
        motion.rows,
        max(onsets, default=math.nan),
        max((one.rest_s for one in outcome.axes), default=math.nan) if outcome is not None and outcome.at_rest else math.nan,
        outcome.of(axis).travel if outcome is not None else math.nan,
        outcome.of(axis).ending if outcome is not None else "",
        outcome.watched_s if outcome is not None else 0.0,
        outcome.axes if outcome is not None else (),
        budget_use(machine, axis, trial, run.motion, onset_s) if verdict == "stopped" else None,
        tuple(contradictions(said, witness)) if len(run.motion) else (),
        round(time.process_time() - began_s, 2),
    )


@dataclass
class _Run:
    """A run in lockstep, and what truly happened in it."""

    motion: MotionLog
    events: list[FaultEvent]
    status: int = 0
    stopped: bool = False
    lines: list[str] = field(default_factory=list)
    troubles: tuple[str, ...] = ()
    said_row: int = 0  # of the truth, when the run had said all
    since_stop_s: float = math.nan  # from the beginning of the last stop until then
    rows: int = 0
    pose: np.ndarray = field(default_factory=lambda: np.zeros(0))  # where the bench believes it to stand at the end
    positions: dict[str, np.ndarray] = field(default_factory=dict)  # by channel, of the recording or the truth; empty where it was stopped


def _run(machine: Machine, faults: tuple[FaultSetting, ...], motion: Motion) -> _Run:
    run, request = _Run(MotionLog(machine.axes), []), StopRequest()
    options = BenchOptions("lockstep:", faults=faults, motion=run.motion, events=run.events)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "run.mf4"
        try:
            with _limited(PROCESSOR_LIMIT_S), open_bench(machine, options, motion.start_pose, stop_request=request) as bench:
                try:
                    notes, judged = motion.make(bench, path)
                    run.lines += (*notes, *judged)
                    run.status, run.pose = 1 if judged else 0, bench.pose
                finally:
                    link = bench.wiring.link
                    run.troubles, run.said_row, run.since_stop_s = tuple(link.troubles), len(run.motion) - 1, link.since_stop_s
        except _EndlessError:
            run.status, run.stopped = 1, True
            run.lines.append(f"has taken {PROCESSOR_LIMIT_S:g} s of processor time and {GIVEN_UP}")
        except Exception as error:
            if request.reason:
                raise  # by the user, who wants the table to end
            run.stopped = True
            line, run.status = in_one_line(error)
            run.lines.append(line)
        recording = _kept_recording(path)
        if recording is not None:
            run.rows = len(recording.channels["time"].values)
            run.positions = {name: each.values for name, each in recording.channels.items() if "position_" in name and not run.stopped}
        elif not run.stopped:
            ended = zip(machine.axes, run.motion.position.T, run.pose, strict=True)
            run.positions = {f"position_{axis}": _ends(position, believed) for axis, position, believed in ended}
    return run


def _ends(position: np.ndarray, believed: float) -> np.ndarray:
    """Return how far an axis went either way, where it ended, and how far off the bench believes it to be."""
    return np.array([position.min(), position.max(), position[-1], position[-1] - believed])


def _verdict(trial: FaultTrial, run: _Run, outcome: FaultOutcome | None, *, complete: bool) -> Verdict:
    if run.lines and run.lines[-1].endswith(GIVEN_UP):
        return "did not end"
    if outcome is None or not complete:
        return "never began"
    if not outcome.at_rest:
        moving = [axis.ending == "moving" for axis in outcome.axes]
        lost = trial.brake == "absent" and not run.motion.effort[-1][moving].any()
        return "cannot be held" if lost and run.lines[-1].startswith(KEEP_AWAY) else "not at rest"
    if run.stopped:
        return "stopped"
    return "noted" if run.lines else "unnoticed"


def _as_sound(machine: Machine, axis: str, motion: Motion, positions: dict[str, np.ndarray]) -> bool:
    """Return whether every position is that of a run without faults, up to what the encoders may be off by."""
    key = (machine.hash, axis, motion.name)
    if key not in _sound_positions:
        sound = _run(machine, (), motion)
        if sound.stopped or sound.lines:
            raise UnusableInputError(f"{machine.name}: no fault can be judged, since a run without one says: {'; '.join(sound.lines)}")
        _sound_positions[key] = sound.positions
    tolerances = {f"{side}_{judged.sensor.removeprefix('encoders_')}": judged.tolerance
                  for judged in machine.judging.encoders for side in ("position", "link_position")}  # fmt: skip
    return all(
        len(values) == len(positions[name]) and bool((np.abs(values - positions[name]) <= tolerances[name]).all())
        for name, values in _sound_positions[key].items()
        if name in tolerances
    )


_sound_positions: dict[tuple[str, str, str], dict[str, np.ndarray]] = {}


@contextlib.contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """End the block with `_EndlessError` after so much processor time, where the system can tell."""
    if not hasattr(signal, "setitimer"):
        yield
        return

    def give_up(signum: int, frame: FrameType | None) -> None:
        raise _EndlessError

    before = signal.signal(signal.SIGVTALRM, give_up)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def _kept_recording(path: Path) -> Recording | None:
    """Return what can be read of a recording; None where there is none."""
    if not path.is_file():
        return None
    try:
        return read_recording(path)
    except RecordingError:
        return None


def _key(machine: Machine, axis: str, trial: FaultTrial, motion: MotionName) -> str:
    """Return what an outcome depends on, as a digest: the machine, the software, the faults and the motion."""
    text = "\n".join((machine.hash, _software(), axis, motion, trial.name, faults_text(trial.settings)))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@cache
def _software() -> str:
    """Return a digest of the program's files: outcomes of a program that was changed are not those of this one."""
    digest = hashlib.sha256(software_version().encode())
    for package in PACKAGES:
        for path in sorted((Path(__file__).parents[2] / package).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _as_json(outcome: TrialOutcome) -> dict[str, Any]:
    document = plain(outcome)
    assert isinstance(document, dict)
    return document


def _keep(path: Path, line: str) -> None:
    """Add a line to a file, behind one that may have been cut off."""
    cut_off = path.is_file() and path.stat().st_size > 0 and not path.read_bytes().endswith(b"\n")
    with path.open("a", encoding="utf-8") as file:
        file.write(("\n" if cut_off else "") + line + "\n")


def _kept(path: Path) -> dict[str, TrialOutcome]:
    """Return the outcomes of earlier runs by their key; a line that was cut off counts for nothing."""
    found = {}
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    for line in lines:
        with contextlib.suppress(ValueError, TypeError, KeyError):
            entry = json.loads(line)
            key = entry.pop("key")
            found[key] = _from_json(entry)
    return found


def _from_json(entry: dict[str, Any]) -> TrialOutcome:
    """Return an outcome as `_as_json` wrote it: null is NaN."""

    def numbers(table: dict[str, Any]) -> dict[str, Any]:
        return {key: math.nan if value is None else value for key, value in table.items()}

    axes = tuple(AxisOutcome(**numbers(axis)) for axis in entry.pop("axes"))
    used = entry.pop("budget")
    budget = None
    if used is not None:
        name = used.pop("name")
        budget = BudgetUse(name, **{key: math.inf if value is None else value for key, value in used.items()})
    lists = {name: tuple(entry.pop(name)) for name in ("stopping", "contradicted")}
    return TrialOutcome(**numbers(entry) | lists | {"axes": axes, "budget": budget})
