"""Commissioning: from a machine file to an identified, shaped and checked machine, in one go."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from controllers.errors import DesignError
from hil.bench.bench import Bench
from hil.bench.open import open_bench, recording_paths
from hil.bench.options import BenchOptions
from hil.errors import UnusableInputError
from hil.experiments import Experiment, Jog, JogOnly, Multisine, Static
from hil.experiments.modest import Possible, middle_pose, modest_scan
from hil.experiments.plan import pose_array
from hil.files.unused import unused_folder
from hil.identification import identify_poses, resonances, write_frf
from hil.identification.report import resonance_lines
from hil.machine import Machine
from hil.machine.load import name_to_load
from hil.observing import emulated_design, write_design
from hil.pages import Verdict, write_page
from hil.pages.contents import Kind
from hil.recording import Recording, read_recording
from hil.reports.commissioned import commissioned_page
from hil.reports.made_from import command_line
from hil.shaping.choice import choose_shaper
from hil.shaping.plans import Shaped
from hil.shaping.shaper_file import write_shaper
from hil.simulation import Comparison, compare, in_effort, simulate
from hil.verbs.check import findings_of
from hil.verbs.errors import as_bench_errors
from hil.verbs.observe import DEFAULT_MODES

STILL_S = 5.0
"""A thousand rows of noise."""

REPEATS = 3
"""The fewest by which noise is told from what repeats have in common."""

REPEATED = JogOnly(jog=Jog(0.06, line=1), period_s=10.0, periods=1)
OTHER = JogOnly(jog=Jog(0.045, line=1), period_s=8.0, periods=1)
"""The repeated motion and another one to judge by, slow enough for any axis: amplitudes of 3.4 and 2.6 degrees."""

ROOM = REPEATED.jog.amplitude_rad
"""About the middle pose, for the repeated motion."""

EXCITATION_SHARE = 0.1
"""Rms of the excitation as a share of what the drive may give: 0.8 A on the C-arm."""

PERIODS, REALISATIONS = 2, 2
"""The fewest that tell noise from nonlinear distortion."""


@dataclass(frozen=True)
class Step:
    """One step of a commissioning.

    Attributes
    ----------
    name : str
    ok : bool
    said : tuple of str
        What was found, a line each.
    files : tuple of Path
        What it left.
    """

    name: str
    ok: bool
    said: tuple[str, ...]
    files: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Commissioning:
    """What a commissioning found.

    Attributes
    ----------
    machine : Machine
    folder : Path
    steps : tuple of Step
    emulated : bool
        Whether anything was recorded on the emulator.
    comparison : Comparison or None
        Of the first repeat with its simulation, in units of what repeats do not have in common; None where it did not come so far.
    next_command : tuple of str
        What to type next, and what that brings.
    page : Path or None
        The page of it all; None where nothing was recorded.
    """

    machine: Machine
    folder: Path
    steps: tuple[Step, ...]
    emulated: bool
    comparison: Comparison | None
    next_command: tuple[str, str]
    page: Path | None

    @property
    def verdict(self) -> str:
        """Whether the machine is commissioned, in a sentence."""
        return _verdict(self.machine, self.steps, self.comparison)

    @property
    def ok(self) -> bool:
        """Whether every step passed."""
        return all(step.ok for step in self.steps)

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "machine": self.machine.name,
            "folder": self.folder,
            "hash": self.machine.hash,
            "ok": self.ok,
            "says": self.verdict,
            "next": self.next_command[0],
            "page": self.page,
            "emulated": self.emulated,
            "comparison": None if self.comparison is None else self.comparison.document(),
            "steps": [vars(step) for step in self.steps],
        }


@as_bench_errors()
def commission(
    machine: Machine,
    bus: str,
    out: str | Path,
    *,
    emulated: Machine | None = None,
    seed: int = 0,
    imu: str = "",
    io: str = "",
    observer: bool = False,
    told: Callable[[Step], None] = lambda step: None,
    progress: Callable[[str, int, int], None] = lambda name, done, total: None,
) -> Commissioning:
    """Check a machine, home it, record it at rest and in motion, identify it, design its shapers, and hold its simulation against it.

    Parameters
    ----------
    machine : Machine
    bus : str
        As `OpenMachine.run`.
    out : str or Path
        Folder for recordings, frequency response and shapers; where it is in use, a new one beside it is taken (`folder` says which).
    emulated : Machine, optional
        In lockstep, the machine that is really there.
    seed : int
        In lockstep, of the emulated sensors' noise.
    imu, io : str
        Addresses of IMU and I/O where the machine file names none.
    observer : bool
        Whether an observer is designed from the machine file, too.
    told : callable
        Told of every step when it is done.
    progress : callable
        Told what is recorded, and how many of how many rows are; in lockstep.

    Returns
    -------
    Commissioning
        It ends with the first step that fails.

    Raises
    ------
    ExperimentError, LoopAbortedError
        A motion is not possible on this machine, or the motors were stopped.
    """
    if emulated is not None and not bus.startswith("lockstep:"):
        raise UnusableInputError("emulated: only a run on lockstep: emulates; give that machine to `isocenter emulate`")
    under_way = _UnderWay(machine, unused_folder(Path(out)), told, progress, observes=observer)
    if under_way.check():
        under_way.folder.mkdir(parents=True, exist_ok=True)
        options = BenchOptions(bus, imu, io, seed=seed, emulated=emulated)
        with open_bench(machine, options, pose_array(machine, middle_pose(machine, ROOM))) as bench:
            under_way.run(bench)
    next_command = under_way.next_command()
    page = under_way.page(next_command)
    return Commissioning(machine, under_way.folder, tuple(under_way.steps), under_way.emulated, under_way.comparison, next_command, page)


def _verdict(machine: Machine, steps: Sequence[Step], comparison: Comparison | None) -> str:
    failed = [step for step in steps if not step.ok]
    if failed:
        return f"{machine.name} is not commissioned: {failed[0].name} failed: {failed[0].said[0]}"
    agrees = comparison is not None and comparison.agrees
    beside = "and its simulation agrees with the recordings" if agrees else "but its simulation leaves something out"
    return f"{machine.name} is commissioned: all {len(steps)} steps passed, {beside}."


class _UnderWay:
    """A commissioning under way."""

    def __init__(
        self, machine: Machine, folder: Path, told: Callable[[Step], None], progress: Callable[[str, int, int], None], *, observes: bool
    ) -> None:
        self.machine, self.folder, self._told, self._progress, self._observes = machine, folder, told, progress, observes
        self._middle = middle_pose(machine, ROOM)
        self._disbelieved: list[str] = []
        self._repeats: list[Recording] = []
        self._scan: Experiment = Possible(modest_scan(machine, machine.axes[0], self._middle))
        self.steps: list[Step] = []
        self.emulated = False
        self.comparison: Comparison | None = None

    def check(self) -> bool:
        """Check the machine file."""
        findings = findings_of(self.machine)
        failed = [finding.text for finding in findings if not finding.ok]
        return self._done("check", not failed, failed or [f"{len(findings)} checks of the machine file passed"])

    def run(self, bench: Bench) -> None:
        """Home, record, identify, shape, scan, compare; a step that fails is the last."""
        steps = [self._home, self._move_about, self._identify, self._shape, self._sweep, self._compare]
        for step in [*steps, *([self._observe] if self._observes else [])]:
            if not step(bench):
                return

    def _home(self, bench: Bench) -> bool:
        said = list(bench.commission())
        self._disbelieve("on the way home", bench.judged)
        return self._done("home", True, said)

    def _move_about(self, bench: Bench) -> bool:
        """Record the machine at rest, repeats of a slow motion, and another motion."""
        repeats = [f"repeat{n + 1}" for n in range(REPEATS)]
        motions: dict[str, Experiment] = {"still": Static(STILL_S, self._middle)}
        motions |= dict.fromkeys(repeats, replace(REPEATED, pose=self._middle))
        motions["other"] = replace(OTHER, pose=self._middle)
        recorded: dict[str, Recording] = {}
        for name, experiment in motions.items():
            (recorded[name],) = self._record(bench, name, experiment)
            if self._disbelieved:
                break
        else:
            self._repeats = [recorded[name] for name in repeats]
        said = f"{STILL_S:g} s at rest, {REPEATS} repeats of a slow sine, and another motion to judge by"
        return self._done("record", True, [said], tuple(self._path(name) for name in recorded))

    def _done(self, name: str, ok: bool, said: list[str], files: tuple[Path, ...] = ()) -> bool:
        """Tell of a step, and return whether it has passed: no step does in which a sensor was not to be believed."""
        step = Step(name, False, tuple(self._disbelieved), files) if self._disbelieved else Step(name, ok, tuple(said), files)
        self.steps.append(step)
        self._told(step)
        return step.ok

    def _disbelieve(self, where: str, judged: Sequence[str]) -> None:
        self._disbelieved += [f"{where}: a sensor is not to be believed: {line}" for line in judged]

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.mf4"

    def _record(self, bench: Bench, name: str, experiment: Experiment) -> list[Recording]:
        """Run an experiment and read what it left."""
        plans = experiment.plans(self.machine)
        paths = recording_paths(self._path(name), plans)
        total = sum(plan.rows for plan in plans)
        done = 0
        for plan, path in zip(plans, paths, strict=True):
            timing = bench.run(plan, path, partial(self._follow, name, done, total) if bench.wiring.lockstep else None)
            self._disbelieve(path.stem, timing.judged)
            done += plan.rows
        recordings = [in_effort(read_recording(path, self.machine), self.machine) for path in paths]
        self.emulated |= any(each.emulated for each in recordings)
        return recordings

    def _follow(self, name: str, done: int, total: int, row: int) -> None:
        self._progress(name, done + row, total)

    def _identify(self, bench: Bench) -> bool:
        """Excite every axis by a tenth of what its drive may give; write the frequency response."""
        amplitude = {each.axis: EXCITATION_SHARE * each.limit for each in self.machine.controllers}
        experiment = Multisine(self._middle, amplitude_A=amplitude, periods=PERIODS, realisations=REALISATIONS)
        recordings = self._record(bench, "multisine", Possible(experiment))
        if self._disbelieved:
            return self._done("identify", True, [])
        (response,) = identify_poses(recordings, "robust_bla")
        path = self.folder / f"{self.machine.name}.frf.npz"
        write_frf(response, path)
        return self._done("identify", True, [line.strip() for line in resonance_lines(resonances(response))], (path,))

    def _shape(self, bench: Bench) -> bool:
        """Design a shaper for every axis; the scan of the first axis goes through its shaper where there is one."""
        said, files = [], []
        for axis in self.machine.axes:
            try:
                choice = choose_shaper(self.machine, axis, pose=self._middle)
            except DesignError as error:
                said.append(f"{axis}: none, {error}")
                continue
            files.append(self.folder / f"{axis}.shaper.npz")
            write_shaper(choice.file, files[-1])
            said.append(f"{axis}: {' '.join(choice.chosen.verdict.line.split())}")
            if axis == self.machine.axes[0]:
                self._scan = Shaped(self._scan, choice.file)
        return self._done("shape", True, said, tuple(files))

    def _sweep(self, bench: Bench) -> bool:
        (recorded,) = self._record(bench, "scan", self._scan)
        way, units = np.ptp(recorded[f"reference_{self.machine.axes[0]}"]), self.machine.units[0]
        shown = f"{np.degrees(way):.0f} degrees" if units.position == "rad" else f"{1e3 * way:.0f} mm"
        said = f"{units.axis} over {shown} in {recorded.rows / self.machine.sample_rate_Hz:.1f} s"
        return self._done("scan", True, [said], (self._path("scan"),))

    def _compare(self, bench: Bench) -> bool:
        """Hold the simulation against the repeated motion, in units of what repeats do not have in common."""
        first, *others = self._repeats
        self.comparison = compare(first, simulate(self.machine, first), others)
        return self._done("compare", True, [self.comparison.verdict])

    def _observe(self, bench: Bench) -> bool:
        """Design an observer with the file's numbers, held to the truth of emulated machines."""
        design = emulated_design(self.machine, modes=DEFAULT_MODES, told=partial(self._progress, "observer"))
        path = self.folder / f"{self.machine.name}.observer.npz"
        write_design(design, path)
        return self._done("observe", True, list(design.notes), (path,))

    def next_command(self) -> tuple[str, str]:
        """Return what to type next, and what that brings."""
        name = name_to_load(self.machine)
        last = self.steps[-1]
        if last.name == "check" and not last.ok:
            return command_line("machine", "check", name), "says of every check what would be right."
        if not last.ok:
            seen = [path for step in self.steps for path in step.files if path.suffix == ".mf4"]
            page = self.folder / "sensors.html"
            return (command_line("plot", *seen, "-o", page), "shows what the sensors gave.") if seen else ("", "")
        if self.comparison is not None and not self.comparison.agrees:
            files = [self._path(f"repeat{n + 1}") for n in range(REPEATS)]
            given = [name, *files, "--held-out", self._path("other"), "-o", self.folder / "diagnosis"]
            return command_line("diagnose", *given), "names what the simulation leaves out."
        return command_line(
            "plot", self._path("scan"), "--simulate", "-o", self.folder / "scan.html"
        ), "shows the scan, with its simulation."

    def page(self, next_command: tuple[str, str]) -> Path | None:
        """Write the page of it all, where there is anything to show."""
        if not self.folder.is_dir():
            return None
        kind: Kind = "bad" if not self.steps[-1].ok else "good" if self.comparison is not None and self.comparison.agrees else "unsure"
        verdict = Verdict(_verdict(self.machine, self.steps, self.comparison), kind)
        steps = [(step.name, step.ok, step.said, step.files) for step in self.steps]
        page = commissioned_page(self.machine, verdict, steps, next_command, self.folder, self.emulated)
        return write_page(page, self.folder / "index.html")
