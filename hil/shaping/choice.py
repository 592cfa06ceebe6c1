"""From a machine, or a frequency response of it, to the shapers of one axis: all designs judged, and one chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.sampled import AxisShaper
from hil.errors import RequestError, UnusableInputError
from hil.experiments.plan import pose_array
from hil.files.frames import data_frame
from hil.identification.result import FrequencyResponse
from hil.machine import Machine
from hil.shaping.aim import Aim, sweep
from hil.shaping.identified import subject_from_frf
from hil.shaping.poses import scheduled_poses, subject_at
from hil.shaping.predicted import Prediction
from hil.shaping.shaper_design import Candidates, Design, QUIET_BAND_Hz, design_all, recommended_first, shaper_of
from hil.shaping.shaper_file import ShaperFile
from hil.shaping.verdict import Residual, Subject
from virtual_bus.linear.left_out import LeftOut, left_out

if TYPE_CHECKING:
    import control
    import pandas as pd


@dataclass(frozen=True)
class Subjects:
    """What shapers are designed for.

    Attributes
    ----------
    each : tuple of Subject
        One per pose.
    poses : (n, n_axes) array or None
        None for a frequency response, which knows its own.
    schedule : str
        Axis over which the poses are spread; "" for one pose.
    fit_error : float
        Relative rms error of the rational function fitted to a frequency response; 0 for a machine file.
    """

    each: tuple[Subject, ...]
    poses: np.ndarray | None
    schedule: str = ""
    fit_error: float = 0.0


@dataclass(frozen=True)
class ShaperChoice:
    """All designs for one axis, and the chosen one.

    Attributes
    ----------
    machine : Machine
    axis : str
    aim : Aim
    subjects : Subjects
    candidates : Candidates
        The recommended design first; with those that failed, and why.
    chosen : Design
    notes : mapping
        Plain values that go into the SHAPER file.
    """

    machine: Machine
    axis: str
    aim: Aim
    subjects: Subjects
    candidates: Candidates
    chosen: Design
    notes: Mapping[str, Any]

    @property
    def designs(self) -> tuple[Design, ...]:
        """All designs, the recommended one first."""
        return self.candidates.designs

    @property
    def positions(self) -> list[float]:
        """Positions [rad or m] of the scheduling axis; [0] where nothing is scheduled."""
        if not self.subjects.schedule or self.subjects.poses is None:
            return [0.0]
        positions: list[float] = self.subjects.poses[:, self.machine.axis_index(self.subjects.schedule)].tolist()
        return positions

    @cached_property
    def shaper(self) -> AxisShaper:
        """The chosen design at the sample rate, as the loop runs it."""
        return shaper_of(self.chosen, self.axis, self.machine.sample_rate_Hz, self.positions, self.subjects.schedule)

    @property
    def outside(self) -> tuple[LeftOut, ...]:
        """Effects of the machine file that the linear loop does not hold; none where it was identified."""
        return () if self.subjects.poses is None else left_out(self.machine.plant.effects)

    @property
    def file(self) -> ShaperFile:
        """What `write_shaper` writes."""
        return ShaperFile((self.shaper,), self.machine.sample_rate_Hz, dict(self.notes))

    @property
    def control(self) -> control.TransferFunction:
        """The chosen shaper from raw to shaped reference, sampled, an object of python-control; of a schedule the first pose."""
        import control  # takes half a second to load, and only this needs it

        taps = np.zeros(self.shaper.transient_samples + 1)
        taps[self.shaper.delays] = self.shaper.gains[0]
        if len(self.shaper.tail):
            raise UnusableInputError(f"{self.chosen.name}: its last tap is filtered, so it is no transfer function of taps alone")
        denominator = np.zeros(len(taps))
        denominator[0] = 1.0
        return control.tf(taps, denominator, dt=1.0 / self.machine.sample_rate_Hz, inputs=["reference_raw"], outputs=["reference"])

    def named(self, name: str) -> ShaperChoice:
        """Return the same with another design chosen; DesignError names the designs where there is none of this name."""
        chosen = self.candidates.named(name)
        return replace(self, chosen=chosen, notes={**self.notes, "verdict": chosen.verdict.line})

    def frame(self) -> pd.DataFrame:
        """Return the verdicts, a row per design; UnusableInputError without pandas, an extra."""
        rows = [design.verdict.row for design in self.designs]
        columns = {name: [row[name] for row in rows] for name in rows[0] if name != "name"}
        return data_frame(columns, index=[design.name for design in self.designs], index_name="design")


def choose_shaper(
    machine: Machine,
    axis: str,
    *,
    pose: Mapping[str, float] | None = None,
    frf: FrequencyResponse | None = None,
    aim: Aim | None = None,
    schedule: str = "",
    output: str = "link",
    quiet_Hz: tuple[float, float] = QUIET_BAND_Hz,
    also: Sequence[str] = (),
    take: str | None = None,
) -> ShaperChoice:
    """Design reference shapers for one axis, judge them, and choose the recommended one.

    Parameters
    ----------
    machine : Machine
    axis : str
        Axis whose reference is shaped.
    pose : mapping, optional
        Positions by axis name [rad or m] at which the machine file's closed loop is taken; axes left out stand at zero.
    frf : FrequencyResponse, optional
        Design from this identified response instead of the machine file.
    aim : Aim, optional
        `hil.shaping.aim.sweep` unless given, or `periodic` for a scan that repeats.
    schedule : str
        Design over the whole range of this axis, and interpolate.
    output : "link", "detector" or "motor"
        What shall track.
    quiet_Hz : (low, high)
        Band that the quiet design passes least in.
    also : sequence of str
        Designs beside the usual ones: "shortest", "dc", "zpetc", "zmetc".
    take : str, optional
        Design to choose in place of the recommended one.

    Raises
    ------
    RequestError
        No such axis, or a pose or schedule beside a frequency response.
    DesignError
        Nothing can be designed for this loop, or there is no design named `take`.
    """
    check_request(machine, axis, schedule, pose or {}, frf is not None)
    aim = aim or sweep()
    subjects = subjects_of(machine, axis, pose or {}, frf, schedule, output)
    candidates = design_all(subjects.each, aim, machine.sample_rate_Hz, quiet_Hz, also)
    if take:
        candidates.named(take)  # refused before moves are simulated, which takes seconds
    if subjects.poses is not None and machine.controllers:
        candidates = as_simulated(machine, axis, subjects, candidates)
    chosen = candidates.named(take) if take else candidates.designs[0]
    from_what = "an identified frequency response" if frf is not None else f"the closed loop of {machine.name}'s file"
    notes = {"machine": machine.name, "hash": machine.hash, "aim": vars(aim), "source": from_what, "output": output}
    return ShaperChoice(machine, axis, aim, subjects, candidates, chosen, {**notes, "verdict": chosen.verdict.line})


def check_request(machine: Machine, axis: str, schedule: str, pose: Mapping[str, float], is_identified: bool) -> None:
    """Refuse an axis that there is not, and a pose or a schedule beside a frequency response, which is of one pose.

    Raises
    ------
    RequestError
    """
    for part, name in (("axis", axis), ("schedule", schedule)):
        if name not in machine.axes and (name or part == "axis"):
            raise RequestError("{" + part + "} {}: {} has {}", name, machine.name, ", ".join(machine.axes))
    if is_identified and (schedule or pose):
        raise RequestError("{frf}: a frequency response is of one pose; leave out {schedule} and {pose}")


def as_simulated(machine: Machine, axis: str, subjects: Subjects, candidates: Candidates) -> Candidates:
    """Return the designs with what they leave of drawn moves as simulated, and ordered by it.

    Designs with objections stay as they are, and all do where no moves can be drawn, for a reason that the candidates then tell. That its
    moves alone cannot be speaks against a design. Of a schedule the moves begin at its middle pose.
    """
    assert subjects.poses is not None
    fit = [design for design in candidates.designs if not design.verdict.against]
    positions = subjects.poses[:, machine.axis_index(subjects.schedule)].tolist() if subjects.schedule else [0.0]
    shapers = [shaper_of(design, axis, machine.sample_rate_Hz, positions, subjects.schedule) for design in fit]
    found: dict[str, Residual] = {}
    reasons: dict[str, str] = {}
    try:
        prediction = Prediction(machine, axis, subjects.poses[len(subjects.poses) // 2])
    except DesignError as error:
        return replace(candidates, not_simulated=str(error))
    for design, shaper in zip(fit, shapers, strict=True):
        try:
            found[design.name] = prediction.of(shaper)
        except DesignError as error:
            reasons[design.name] = str(error)
    if reasons and not found:
        return replace(candidates, not_simulated=next(iter(reasons.values())))
    designs = [_as_simulated(design, found.get(design.name), reasons.get(design.name, "")) for design in candidates.designs]
    return replace(candidates, designs=recommended_first(designs))


def _as_simulated(design: Design, residual: Residual | None, reason: str) -> Design:
    """Return a design with what it leaves, or with why its moves cannot be simulated where those of others can."""
    verdict = replace(design.verdict, against=reason or design.verdict.against)
    return replace(design, verdict=verdict if residual is None else verdict.simulated(residual))


def subjects_of(
    machine: Machine, axis: str, pose: Mapping[str, float], frf: FrequencyResponse | None, schedule: str = "", output: str = "link"
) -> Subjects:
    """Return what shapers of an axis are designed for; see `choose_shaper`."""
    if frf is not None:
        found, error = subject_from_frf(machine, frf, axis, output)
        return Subjects((found,), None, fit_error=error)
    at = pose_array(machine, pose)
    poses = scheduled_poses(machine, at, schedule) if schedule else at[None, :]
    return Subjects(_at_poses(machine, poses, axis, output), poses, schedule)


def _at_poses(machine: Machine, poses: Sequence[np.ndarray] | np.ndarray, axis: str, output: str) -> tuple[Subject, ...]:
    return tuple(subject_at(machine, each, axis, output) for each in poses)
