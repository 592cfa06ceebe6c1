"""Experiments run and recorded, and motions that are not recorded."""

from __future__ import annotations

import logging
import shutil
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from hil.bench.margins import accepted_margins
from hil.bench.open import open_bench, recording_paths
from hil.bench.options import BenchOptions
from hil.errors import UnusableInputError
from hil.experiments import Experiment, Multisine, Plan
from hil.files.aside import keep_earlier
from hil.machine import Machine
from hil.machine.faults_file import read_faults_file
from hil.observing import ObserverDesign
from hil.observing.live import LiveObserver
from hil.recording import Recording, RecordingWarning, read_recording
from hil.recording.formats import check_writable
from hil.shaping.choice import ShaperChoice
from hil.shaping.plans import Shaped
from hil.shaping.shaper_file import ShaperFile, read_shaper
from hil.verbs.errors import as_bench_errors
from hil.verbs.observe import live_observer
from hil.verbs.recordings import Recordings

LOG = logging.getLogger("hil")
LOCKSTEP = "lockstep:"


@as_bench_errors()
def run(
    machine: Machine,
    experiment: Experiment,
    *,
    bus: str,
    out: str | Path | None = None,
    shaper: ShaperChoice | ShaperFile | str | Path | None = None,
    observer: ObserverDesign | str | Path | None = None,
    seed: int = 0,
    noise: bool = True,
    emulated: Machine | None = None,
    faults: str | Path | None = None,
    truth: str | Path | None = None,
    frame_log: str | Path | None = None,
    imu: str = "",
    io: str = "",
    real_time: bool = True,
    accept_margins: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Recording | Recordings:
    """Run an experiment and return what was recorded: see `OpenMachine.run`."""
    if not bus.startswith(LOCKSTEP):
        for name, given in (("emulated", emulated), ("faults", faults), ("truth", truth)):
            if given is not None:
                raise UnusableInputError(f"{name}: only a run on {LOCKSTEP} emulates; on {bus} give it to `isocenter emulate`")
    if emulated is not None and (emulated.axes, emulated.sample_rate_Hz) != (machine.axes, machine.sample_rate_Hz):
        raise UnusableInputError(
            f"emulated: {emulated.name} has {', '.join(emulated.axes)} at {emulated.sample_rate_Hz:g} Hz,"
            f" {machine.name} has {', '.join(machine.axes)} at {machine.sample_rate_Hz:g} Hz"
        )
    plans = (experiment if shaper is None else Shaped(experiment, _shaper(shaper))).plans(machine)
    for note in dict.fromkeys(note for plan in plans for note in plan.notes):
        LOG.info("%s: %s", machine.name, note)
    options = BenchOptions(
        bus,
        imu,
        io,
        seed=seed,
        noise=noise,
        frame_log=_path(frame_log),
        truth=_path(truth),
        emulated=emulated,
        faults=() if faults is None else read_faults_file(faults, emulated or machine),
        real_time=real_time,
        accepted_margins=accepted_margins(machine, accept_margins, "accept_margins=True"),
    )
    scratch = None if out is not None else Path(tempfile.mkdtemp(prefix="isocenter-"))
    paths = recording_paths(Path(out) if scratch is None and out is not None else Path(scratch or ".") / "run.mf4", plans)
    try:
        recordings = _recorded(machine, options, plans, paths, live_observer(observer, machine), progress)
    except Exception as error:
        if scratch is not None:
            if any(scratch.iterdir()):
                error.add_note(f"what was recorded until then is kept in {scratch}")
            else:
                scratch.rmdir()
        raise
    if scratch is not None:
        shutil.rmtree(scratch)
    named = Recordings(dict(zip([path.stem for path in paths], recordings, strict=True)))
    return named if isinstance(experiment, Multisine) or len(named) != 1 else named[0]


def _recorded(
    machine: Machine,
    options: BenchOptions,
    plans: Sequence[Plan],
    paths: Sequence[Path],
    observer: LiveObserver | None,
    progress: Callable[[int, int], None] | None,
) -> list[Recording]:
    """Run plans one after the other, and read what they left."""
    for path in paths:
        check_writable(path)
        if kept := keep_earlier(path):
            LOG.info(kept)
    total, done = sum(plan.rows for plan in plans), 0
    with open_bench(machine, options, plans[0].start_pose, observer) as bench:
        for plan, path in zip(plans, paths, strict=True):
            follow = None if progress is None else _follower(progress, done, total)
            timing = bench.run(plan, path, follow if options.bus_url.startswith(LOCKSTEP) else None)
            done += plan.rows
            if progress is not None:
                progress(done, total)
            _warn(path.stem, timing.notes, timing.judged)
    return [read_recording(path, machine) for path in paths]


def _warn(name: str, notes: Sequence[str], judged: Sequence[str]) -> None:
    """Tell of notes on a motion, and of sensors with which it went on though they were not to be believed."""
    for said in (*notes, *(f"a sensor is not to be believed: {line}" for line in judged)):
        warnings.warn(f"{name}: {said}", RecordingWarning, stacklevel=5)


def _follower(progress: Callable[[int, int], None], done: int, total: int) -> Callable[[int], None]:
    return lambda row: progress(done + row, total)


@as_bench_errors()
def home(machine: Machine, bus: str, *, imu: str = "", io: str = "") -> tuple[str, ...]:
    """Home a machine: see `OpenMachine.home`."""
    with open_bench(machine, BenchOptions(bus, imu, io)) as bench:
        found = bench.commission()
        _warn("home", (), bench.judged)
        return found


@as_bench_errors()
def move(machine: Machine, to: Mapping[str, float], bus: str, *, imu: str = "", io: str = "") -> dict[str, float]:
    """Go to a pose: see `OpenMachine.move`."""
    if unknown := [axis for axis in to if axis not in machine.axes]:
        raise UnusableInputError(f"{unknown[0]}: {machine.name} has {', '.join(machine.axes)}")
    with open_bench(machine, BenchOptions(bus, imu, io)) as bench:
        pose = bench.pose.copy()
        for axis, position in to.items():
            pose[machine.axis_index(axis)] = position
        reached = dict(zip(machine.axes, bench.move(pose).tolist(), strict=True))
        _warn("move", bench.wiring.link.remarks, bench.judged)
        return reached


def _shaper(given: ShaperChoice | ShaperFile | str | Path) -> ShaperFile:
    if isinstance(given, ShaperChoice):
        return given.file
    return given if isinstance(given, ShaperFile) else read_shaper(given)


def _path(given: str | Path | None) -> Path | None:
    return None if given is None else Path(given)
