"""Is a machine file fit to be run: margins and natural frequencies over its poses, holding efforts, bus load, device files."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

from hil.machine.bus_load import bus_load
from hil.machine.check_budgets import budgets
from hil.machine.check_ramps import ramps
from hil.machine.closed_loop import Margins, position_loop
from hil.machine.finding import Finding, PoseResult, shown_pose
from hil.machine.machine import Machine
from virtual_bus.linear.left_out import LeftOut, left_out, sentences, without

if TYPE_CHECKING:
    from virtual_bus.physics import Physics

PHASE_MARGIN_deg = 40.0
GAIN_MARGIN_dB = 6.0
HOLDING_SHARE = 0.75
"""Share of the drive's limit that standing still may take: the rest is for acceleration, friction and excitation."""

BUS_LOAD = 0.6
"""Share of the bit rate that the cyclic frames may take: SDO, heartbeats and retries want the rest."""

INTEGRATOR_SLACK = 1e-9
"""Rounding of an integrator's pole in a machine file."""

POSES = 81
MOST_PER_AXIS = 9
LIGHTLY_DAMPED = 0.2


def check_machine(machine: Machine, poses: int = POSES) -> list[Finding]:
    """Every check, the failed ones marked.

    Parameters
    ----------
    machine : Machine
    poses : int
        At most so many poses of a grid over the axes' ranges are looked at.
    """
    results = examine(machine, poses)
    findings = [*_modes(machine, results), *_holding(machine, results)]
    findings += [*_controllers(machine, results), *_left_out(machine)]
    if machine.bus is not None:
        findings += [_bus_load(machine), *_device_files(machine), *ramps(machine), *budgets(machine, results)]
    return findings


def failing_controllers(machine: Machine, poses: int = POSES) -> list[Finding]:
    """Return those of `check_machine`'s findings on the controllers that failed: stability, margins, reference filters."""
    return [finding for finding in _controllers(machine, examine(machine, poses)) if not finding.ok]


def examine(machine: Machine, poses: int = POSES) -> list[PoseResult]:
    """Linearise the machine at every pose of a grid over its ranges."""
    from virtual_bus.physics import Physics  # here because it compiles the plant

    physics = Physics(machine.plant, noise=False)
    return [_examine_pose(machine, physics, pose) for pose in pose_grid(machine, poses)]


def pose_grid(machine: Machine, poses: int) -> list[tuple[float, ...]]:
    """At most `poses` poses over the axes' ranges, ends included; zero for an axis without a range."""
    ranged = sum(math.isfinite(limit.lower) and math.isfinite(limit.upper) for limit in machine.limits)
    each = min(MOST_PER_AXIS, max(3, int(poses ** (1.0 / max(ranged, 1)) + 1e-9)))
    each -= 1 - each % 2  # odd, so that the middle is looked at
    ways = [
        np.linspace(limit.lower, limit.upper, each) if math.isfinite(limit.lower) and math.isfinite(limit.upper) else np.zeros(1)
        for limit in machine.limits
    ]
    return [tuple(float(position) for position in pose) for pose in itertools.product(*ways)]


def _examine_pose(machine: Machine, physics: Physics, pose: tuple[float, ...]) -> PoseResult:
    linear = physics.linear(np.array(pose))
    radius: float = math.nan
    margins: tuple[Margins, ...] = ()
    if machine.controllers:
        loop = position_loop(machine, linear)
        radius, margins = loop.pole_radius(), loop.margins()
    poles = linear.poles
    poles = poles[(poles.imag > 0.0) & (np.abs(poles.real) < LIGHTLY_DAMPED * np.abs(poles))]
    modes = sorted((float(abs(pole)) / (2.0 * math.pi), float(-pole.real / abs(pole))) for pole in poles)
    return PoseResult(pose, physics.holding_effort(np.array(pose)), _inertia(physics, pose), tuple(modes), radius, margins)


def _inertia(physics: Physics, pose: tuple[float, ...]) -> np.ndarray:
    """Return each axis's inertia (axes,) [kg m^2 or kg] at its joint, all other joints held."""
    from virtual_bus.plant.linearise import inertia_matrix
    from virtual_bus.plant.statics import resting_state

    joints = physics.plant.joint_of_axis()
    positions = resting_state(physics.plant, physics.model, np.array(pose), held_by_brakes=False)[: physics.plant.joints]
    inertia = inertia_matrix(physics.plant, physics.model, positions)
    return np.array([inertia[joints[axis], joints[axis]] for axis in physics.axes])


def _modes(machine: Machine, results: list[PoseResult]) -> list[Finding]:
    """Range of every natural frequency, paired in rising order where all poses have as many."""
    # a pendulum's slow swing is there in one pose and gone in another: count from the top
    fewest = min(len(result.modes) for result in results)
    findings = []
    outside = without(machine.plant.effects)
    for number in range(fewest):
        at = [result.modes[len(result.modes) - fewest + number] for result in results]
        low, high = min(at), max(at)
        dampings = [damping for _, damping in at]
        low_at, high_at = results[at.index(low)].pose, results[at.index(high)].pose
        text = f"mode {number + 1}: {low[0]:.2f} to {high[0]:.2f} Hz over the poses, damping {min(dampings):.1%} to {max(dampings):.1%}"
        if high[0] - low[0] > 1e-3 * high[0]:
            text += f"; lowest at {shown_pose(machine, low_at)}, highest at {shown_pose(machine, high_at)}"
        stable = min(dampings) > -1e-9
        values = {"frequency_Hz": [low[0], high[0]], "damping": [min(dampings), max(dampings)]}
        findings.append(Finding("mode", stable, text + outside, values, bool(outside)))
    return findings


def _holding(machine: Machine, results: list[PoseResult]) -> list[Finding]:
    findings = []
    for axis, drive in enumerate(machine.plant.drives):
        worst = max(results, key=lambda result: abs(result.holding[axis]))
        effort = float(worst.holding[axis])
        allowed = HOLDING_SHARE * drive.limit
        text = (
            f"{drive.axis}: holding takes at most {abs(effort):.3g} {drive.unit} (at {shown_pose(machine, worst.pose)}), "
            f"{abs(effort) / drive.limit:.0%} of its {drive.limit:g} {drive.unit} limit; up to {HOLDING_SHARE:.0%} is right"
        )
        findings.append(Finding("holding", abs(effort) <= allowed, text, {"axis": drive.axis, "effort": effort, "limit": drive.limit}))
    return findings


def _controllers(machine: Machine, results: list[PoseResult]) -> list[Finding]:
    if not machine.controllers:
        return []
    return [_stability(machine, results), *_margins(machine, results), *_reference_filters(machine)]


def _left_out(machine: Machine) -> list[Finding]:
    """Return a finding per effect of the file that modes, stability and margins do not know, with its places and the reason."""
    by_name: dict[str, list[LeftOut]] = {}
    for each in left_out(machine.plant.effects):
        by_name.setdefault(each.name, []).append(each)
    return [
        Finding("left_out", True, f"modes, stability and margins are without {said}", {"left_out": [vars(each) for each in found]})
        for found in by_name.values()
        for said in sentences(found)
    ]


def _stability(machine: Machine, results: list[PoseResult]) -> Finding:
    worst = max(results, key=lambda result: result.pole_radius)
    ok = worst.pole_radius < 1.0
    text = f"closed loop {'stable' if ok else 'not stable'} in {len(results)} poses, largest pole radius {worst.pole_radius:.6f}"
    if not ok:
        unstable = sum(result.pole_radius >= 1.0 for result in results)
        text = f"closed loop unstable in {unstable} of {len(results)} poses, worst at {shown_pose(machine, worst.pose)}; lower the gain"
    values = {"pole_radius": worst.pole_radius, "pose": worst.pose, "poses": len(results)}
    outside = without(machine.plant.effects)
    return Finding("stability", ok, text + outside, values, bool(outside))


def _reference_filters(machine: Machine) -> list[Finding]:
    """Check a separate C_r by itself: it stands outside the loop, so no feedback holds an unstable pole of it."""
    findings = []
    for controller in machine.controllers:
        if controller.reference_sections is not None:
            radius = max(float(np.abs(np.roots(section[3:])).max(initial=0.0)) for section in controller.reference_sections)
            ok = radius < 1.0 + INTEGRATOR_SLACK
            said = f"reference sections {'stable' if ok else 'unstable'}, largest pole radius {radius:.6f}"
            text = f"{controller.axis}: {said}; at most 1 is right"
            findings.append(Finding("reference_filter", ok, text, {"axis": controller.axis, "pole_radius": radius}))
    return findings


def _margins(machine: Machine, results: list[PoseResult]) -> list[Finding]:
    findings = []
    outside = without(machine.plant.effects)
    for axis, name in enumerate(machine.axes):
        for what, unit, least, value, at in (
            ("phase", "deg", PHASE_MARGIN_deg, "phase_deg", "phase_at_Hz"),
            ("gain", "dB", GAIN_MARGIN_dB, "gain_dB", "gain_at_Hz"),
        ):
            worst = min(results, key=lambda result: getattr(result.margins[axis], value))
            margin, frequency = getattr(worst.margins[axis], value), getattr(worst.margins[axis], at)
            text = f"{name}: {what} margin at least {margin:.1f} {unit}"
            if margin == -math.inf:
                text += f": no change of its {what} is found that makes the loop stable at {shown_pose(machine, worst.pose)}"
            elif math.isfinite(margin):
                text += f" (at {frequency:.2f} Hz, {shown_pose(machine, worst.pose)})"
            text += f"; at least {least:g} {unit} is right{outside}"
            numbers = {"axis": name, value: margin, at: frequency, "pose": worst.pose}
            findings.append(Finding(f"{what}_margin", margin >= least, text, numbers, bool(outside)))
        crossovers = [result.margins[axis].crossover_Hz for result in results]
        low, high = min(crossovers), max(crossovers)
        text = f"{name}: loop gain falls through 1 at {low:.2f} to {high:.2f} Hz"
        findings.append(Finding("crossover", True, text + outside, {"axis": name, "crossover_Hz": [low, high]}, bool(outside)))
    return findings


def _bus_load(machine: Machine) -> Finding:
    assert machine.bus is not None
    load = bus_load(machine.bus)
    text = (
        f"bus load {load:.0%} of {machine.bus.bitrate_bit_s / 1000:g} kbit/s at {machine.sample_rate_Hz:g} Hz, worst stuffing; "
        f"up to {BUS_LOAD:.0%} is right"
    )
    return Finding("bus_load", load <= BUS_LOAD, text, {"share": load})


def _device_files(machine: Machine) -> list[Finding]:
    assert machine.bus is not None
    return [
        Finding("eds", False, f"{node.name}: {node.eds}: no such EDS file; put it beside the machine file", {"node": node.name})
        for node in machine.bus.nodes
        if not node.eds.is_file()
    ]
