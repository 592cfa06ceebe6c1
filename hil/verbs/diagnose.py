"""Which physics a simulation leaves out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hil.diagnosis.diagnose import diagnose as diagnose_recordings
from hil.diagnosis.diagnose import fit_everyday
from hil.diagnosis.files import write_diagnosis
from hil.diagnosis.result import Diagnosis
from hil.diagnosis.verdict.values import Everyday
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Recording
from hil.simulation import in_effort
from hil.verbs.errors import as_bench_errors
from hil.verbs.recordings import Several, every_one


@as_bench_errors()
def diagnose(
    machine: Machine,
    recordings: Several,
    held_out: Several = (),
    *,
    out: str | Path | None = None,
    jobs: int | None = None,
    free_runs: bool = False,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Diagnosis:
    """Find where the simulation of a machine and its recordings differ, which physics was left out, and how sure that is.

    Parameters
    ----------
    machine : Machine
        With the effects that are known, which are simulated and not sought.
    recordings : Recording, Recordings or several of them
        To explain; repeats of the same experiment give the noise.
    held_out : the same
        To judge by; nothing is fitted to them.
    out : str or Path, optional
        Folder for the report, `diagnosis.json`, `effects.toml` and the re-tuned `machine.toml`.
    jobs : int, optional
        Processors that free runs may use; all of them unless given.
    free_runs : bool
        Whether effects are judged by free runs of the closed loop, or not at all: they need repeats, recorded by the file's controller.
        Else they judge where the answer along the recorded motion is not sure.
    progress : callable
        Told what is being done, and the share of the whole that is done.

    Returns
    -------
    Diagnosis
        `.verdict`, `.reason`, `.findings`; `.frame()` has a row for every number found, with its interval.

    Raises
    ------
    RecordingError
        Recordings of another machine, copies of each other, or without what is needed, by free runs too where they are asked for.
    """
    train, held = _to_explain(machine, recordings), every_one(held_out, "held out")
    held = {name if name not in train else f"{name} (held out)": in_effort(recording, machine) for name, recording in held.items()}
    outcome = diagnose_recordings(machine, train, held, report=progress, freely=free_runs, jobs=jobs)
    if out is not None:
        write_diagnosis(outcome, machine, Path(out))
    return outcome.diagnosis


@as_bench_errors()
def fit_friction(machine: Machine, recordings: Several) -> Everyday:
    """Fit friction and constant load of every driven joint, with the machine's numbers, as an engineer would; no other physics is sought.

    It is what `diagnose` begins with, in a fifth of its time.

    Parameters
    ----------
    machine : Machine
    recordings : Recording, Recordings or several of them
        As `diagnose` takes them.

    Returns
    -------
    Everyday

    Raises
    ------
    RecordingError
        As `diagnose` does.
    """
    return fit_everyday(machine, _to_explain(machine, recordings))


def _to_explain(machine: Machine, recordings: Several) -> dict[str, Recording]:
    train = every_one(recordings)
    if not train:
        raise RecordingError("no recordings given; three repeats or more of one experiment would be right")
    return {name: in_effort(recording, machine) for name, recording in train.items()}
