"""Shaped plans: the raw reference goes through the shaper as in the loop, and the result is checked against every limit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.filter import ReferenceShaper
from hil.errors import ExperimentError
from hil.experiments.plan import Experiment, Plan
from hil.experiments.safety import Safety, gravity_feedforward
from hil.machine import Machine
from hil.shaping.shaper_file import ShaperFile
from virtual_bus.physics import Physics

GENTLER = 0.85
"""Factor by which acceleration and jerk of the raw reference are lowered until the shaped one keeps the limits."""

GENTLEST = 0.1
"""Share of the limits at which the search ends: the shaper then demands ten times as much as the raw reference."""


class BeyondLimitsError(ExperimentError):
    """The shaped reference exceeds a limit that the raw one keeps; a gentler raw reference helps."""


def shape_plan(plan: Plan, shaper: ShaperFile, machine: Machine) -> Plan:
    """Return the plan with its raw reference shaped, from a standstill at its start pose, and longer by the transient.

    Raises
    ------
    ExperimentError
        The sample rate differs, the machine lacks an axis, H(0) is not 1, or the transient is too long for the scan.
    BeyondLimitsError
        The shaped reference would exceed a limit of range, speed, acceleration or jerk.
    """
    if abs(shaper.sample_rate_Hz / machine.sample_rate_Hz - 1.0) > 1e-9:
        raise ExperimentError(f"shaper: designed for {shaper.sample_rate_Hz:g} Hz; {machine.name} runs at {machine.sample_rate_Hz:g} Hz")
    period, rows = int(plan.metadata["period_samples"]), plan.rows
    if shaper.transient_samples >= period:
        raise ExperimentError(
            f"shaper: its transient takes {shaper.transient_samples / machine.sample_rate_Hz:.3g} s, the scan is over (or repeats) after "
            f"{period / machine.sample_rate_Hz:.3g} s; design it with a shorter one (--longest)"
        )
    try:
        running = ReferenceShaper(machine.axes, shaper.shapers, machine.limits, machine.sample_rate_Hz)
    except DesignError as error:
        raise ExperimentError(str(error)) from None
    raw = np.vstack([plan.reference_raw, np.tile(plan.reference_raw[-1], (shaper.transient_samples, 1))])
    reference, held = shaped(running, raw, plan.start_pose)
    kind = f"shaped {plan.metadata['kind']}"
    safety = Safety(machine, plan.start_pose)
    try:
        safety.check_reference(kind, reference, "; the shaper adds to the raw reference's: plan that more gently")
    except ExperimentError as error:
        raise BeyondLimitsError(str(error)) from None
    if held >= 0:
        raise BeyondLimitsError(f"{kind}: the shaped reference would be held at a limit of range or speed in row {held}")
    peaks = safety.check_motion(kind, reference)
    return Plan(
        plan.axes,
        reference,
        raw,
        np.vstack([plan.excitation, np.zeros((len(raw) - rows, len(plan.axes)))]),
        gravity_feedforward(machine, Physics(machine.plant, noise=False), reference),
        plan.start_pose,
        {**plan.metadata, **_periods(plan, len(raw)), "shaper": {each.axis: each.name for each in shaper.shapers}},
        (*plan.notes[:-1], peaks) if plan.notes else (peaks,),
    )


def shaped(running: ReferenceShaper, raw: np.ndarray, start_pose: np.ndarray) -> tuple[np.ndarray, int]:
    """Shape a raw reference (N, n_axes) sample by sample as in the loop; also return the first row held at a limit, or -1."""
    running.start(start_pose)
    reference, held = np.empty_like(raw), -1
    for k in range(len(raw)):
        if running.step(raw[k], reference[k]) and held < 0:
            held = k
    return reference, held


@dataclass(frozen=True)
class Shaped:
    """An experiment whose raw references go through a shaper."""

    experiment: Experiment
    shaper: ShaperFile

    def plans(self, machine: Machine) -> list[Plan]:
        """Make shaped plans; acceleration and jerk of the raw reference are lowered until the shaped one keeps the limits.

        Raises
        ------
        ExperimentError
            As `shape_plan`, or the limits cannot be kept.
        """
        share = 1.0
        while True:
            try:
                return [_noted(shape_plan(plan, self.shaper, machine), share) for plan in self.experiment.plans(gentler(machine, share))]
            except BeyondLimitsError:
                if share * GENTLER < GENTLEST:
                    raise
                share *= GENTLER


def gentler(machine: Machine, share: float) -> Machine:
    """Return a machine with a share of its limits of acceleration and jerk."""
    limits = tuple(replace(each, acceleration=share * each.acceleration, jerk=share * each.jerk) for each in machine.limits)
    return replace(machine, limits=limits)


def _noted(plan: Plan, share: float) -> Plan:
    if share == 1.0:
        return plan
    note = f"raw reference planned with {share:.0%} of acceleration and jerk, so that the shaped one keeps the limits"
    return replace(plan, notes=(note, *plan.notes))


def _periods(plan: Plan, rows: int) -> dict[str, int]:
    """Return the periods of a shaped plan: a repeated scan settles in its first period; another is one period with its transient."""
    periods = int(plan.metadata["periods"])
    if periods == 1:
        return {"period_samples": rows}
    return {"settle_periods": int(plan.metadata["settle_periods"]) + 1, "periods": periods - 1}
