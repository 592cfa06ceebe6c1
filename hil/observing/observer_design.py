"""Design of an observer: model from frequency responses, gravity from standing records, noise from records, disturbances by tuning."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count, product

import numpy as np

from controllers.models.modal import ModalModel
from controllers.observers.modal_observer import FilterKind, ModalObserver
from controllers.observers.settings import ObserverNoise
from hil.errors import UnusableInputError
from hil.experiments import Plan, Scan, Static
from hil.experiments.modest import holdable, possible_scan
from hil.identification import FrequencyResponse
from hil.machine import Machine
from hil.observing.directions import with_directions
from hil.observing.geometry import observed_chain
from hil.observing.gravity_at_rest import standing_mean, with_gravity, with_gravity_at_places
from hil.observing.last_mode import with_last_mode
from hil.observing.noise import effort_gain, starting_noise
from hil.observing.over_poses import fit_observed_model, harmonics_for, untold_note
from hil.observing.sag import sagging, with_sag
from hil.observing.simulated_recordings import emulated_recording, emulated_responses
from hil.observing.structure import Structure, found_structure, with_coupling, with_inertia, with_places
from hil.observing.tuning import tune
from hil.observing.turning import with_turning
from hil.observing.unmodelled import with_unmodelled, without_counted
from hil.recording import Recording
from hil.simulation import Simulator

GRID = 11
"""Poses of the axis nearest to the detector at which an emulated machine is measured: enough for five harmonics. Shapes of modes that
near each other change within 20°."""

JOG_ROOM = 0.06
"""rad (m) that the outermost poses keep from the ends of the range: the jog and what it brings."""

COARSE_GRID = 5
"""Positions of the other axes: the mount turns against the detector with them, as one or two harmonics."""

STANDING_GRID = 9
"""Positions of the other axes in which it stands: what gravity bends is a sum over modes, each with a shape that turns with them."""

SWEEP_SHARE = 0.75
"""Of the largest speed, at which an emulated machine's axes are swept where they can be: what turning pushes grows with the square."""

STANDING_s = 4.0
"""Length of an emulated standing record: a thousand samples of noise."""


@dataclass(frozen=True)
class ObserverDesign:
    """All that an observer needs to run.

    Attributes
    ----------
    model : ModalModel
    noise : ObserverNoise
    isocenter_m : (3,) in the detector's frame at position zero
    machine : name of the machine it was made for
    machine_hash : of the machine file
    notes : how it was made and how well it fits
    poses : (P, n_axes) at which the machine was measured for it [rad or m]; (0, 0) where that is not known
    """

    model: ModalModel
    noise: ObserverNoise
    isocenter_m: np.ndarray
    machine: str
    machine_hash: str
    notes: tuple[str, ...] = field(default=())
    poses: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def observer(self, kind: FilterKind = "ukf", adapted: Sequence[int] = ()) -> ModalObserver:
        """Return a fresh observer of this design."""
        return ModalObserver(self.model, self.noise, kind, adapted, self.isocenter_m)


def design_observer(
    machine: Machine,
    responses: Sequence[FrequencyResponse],
    standing: Sequence[Recording] = (),
    tuned_on: Sequence[Recording] = (),
    sweeps: Sequence[Recording] = (),
    *,
    modes: int,
) -> ObserverDesign:
    """Design an observer from measurements of a machine.

    Parameters
    ----------
    machine : Machine
    responses : sequence of FrequencyResponse
        One per pose, from the commands to `over_poses.observed_channels`.
    standing : sequence of Recording
        At rest or about a pose; sensors' noise, gravity and biases come from them.
    tuned_on : sequence of Recording
        Ordinary operation, whose innovations should be white.
    sweeps : sequence of Recording
        There and back with nothing that shakes, for what turning pushes; taken with standing records only.
    modes : int
        Of the model.

    Raises
    ------
    UnusableInputError
        No response at all, or sweeps without standing records.
    BadAnswerError
        The modal model cannot be fitted.
    """
    if not responses:
        raise UnusableInputError("an observer's model comes from frequency responses; give one or more, of different poses")
    if sweeps and not standing:
        raise UnusableInputError("what turning pushes is told from gravity by standing records; give some beside the sweeps")
    model, fits = fit_observed_model(machine, responses, modes)
    poses, gain = [fit.pose for fit in fits], effort_gain(machine)
    model = with_directions(with_inertia(model, poses, gain), poses, gain)
    notes = list(model.notes)
    biases: tuple[np.ndarray, np.ndarray] | None = None
    structure: Structure | None = None
    if standing:
        at_rest = [standing_mean(recording, model) for recording in standing]
        model, *found = with_gravity(model, at_rest)
        biases = found[0], found[1]
        notes.append(f"gravity and biases from {len(standing)} standing records: {', '.join(f'{bias:.2g}' for bias in biases[0])}")
        stood = [each.motor for each in at_rest]
        notes += untold_note(stood, harmonics_for(np.array(stood)), "standing records")
        model, mount = with_sag(model, poses, stood, gain)
        structure = found_structure(model, poses, gain, mount)
        if structure:
            model = with_places(sagging(model, structure.mount, stood, gain), structure)
            model, *found = with_gravity_at_places(model, at_rest, gain)
            biases = found[0], found[1]
            notes.append(structure.note)
        else:
            notes.append(mount.note if mount else "the mount's sag is left out: the first axis is not a horizontal one that turns")
    if sweeps:
        model = with_turning(model, found[0], sweeps, gain)
        notes.append(f"what turning pushes from {len(sweeps)} sweeps")
    if structure:
        model = with_coupling(model, structure, gain)
        model, note = with_last_mode(model, structure, max(float(response.frequencies_Hz[-1]) for response in responses))
        notes += [note] if note else []
    noise = with_unmodelled(starting_noise(model, machine, responses, standing, biases), model, machine)
    if tuned_on:
        tuning = tune(model, noise, tuned_on)
        noise = tuning.noise
        notes.append(
            f"tuned on {len(tuned_on)} recordings: NIS {tuning.mean_nis:.2f} per measurement,"
            f" {100.0 * tuning.share_in_band:.1f} % in the 95 % band"
        )
    _, _, _, isocenter = observed_chain(machine)
    return ObserverDesign(model, noise, isocenter, machine.name, machine.hash, tuple(notes), np.array(poses))


def emulated_design(
    machine: Machine,
    tuned_on: Sequence[Recording] = (),
    *,
    modes: int,
    seed: int = 0,
    told: Callable[[int, int], None] = lambda done, total: None,
) -> ObserverDesign:
    """Design an observer for a machine that has not been measured, from measurements of its emulation.

    Experiments are scaled to what the machine can give beside its friction and gravity. Friction, play and sensors' errors of its file are
    not in what is measured, as they are in no modal model: they are counted in the noise, as far as one machine may differ from another.

    Parameters
    ----------
    machine : Machine
    tuned_on : sequence of Recording
    modes, seed : int
    told : callable
        Told how many measurements of how many are done.

    Raises
    ------
    UnusableInputError
        The machine's detector cannot be observed; nothing was measured then.
    ExperimentError
        Its drives hold it at none of the poses, or can give none of an experiment.
    """
    observed_chain(machine)
    last = machine.axes[-1]
    grids = {axis: axis_grid(machine, index, GRID if axis == last else COARSE_GRID) for index, axis in enumerate(machine.axes)}
    at_rest = {axis: grids[axis] if axis == last else axis_grid(machine, index, STANDING_GRID) for index, axis in enumerate(machine.axes)}
    poses, places = (
        holdable(machine, [dict(zip(each, pose, strict=True)) for pose in product(*each.values())]) for each in (grids, at_rest)
    )
    ways = [
        (axis, dict(zip([name for name in machine.axes if name != axis], place, strict=True)))
        for axis in machine.axes
        for place in product(*(grids[name][:: 2 if len(grids[name]) > COARSE_GRID else 1] for name in machine.axes if name != axis))
    ]
    done, total = count(1), len(poses) + len(places) + len(ways)
    told(0, total)
    plain = without_counted(machine)
    responses = emulated_responses(machine, poses, seed, lambda: told(next(done), total), plain)
    simulator = Simulator(plain)

    def recorded(plan: Plan, its_seed: int) -> Recording:
        recording = emulated_recording(machine, plan, its_seed, simulator)
        told(next(done), total)
        return recording

    standing = [recorded(Static(STANDING_s, place).plans(machine)[0], 500 + 100 * seed + i) for i, place in enumerate(places)]
    sweeps = []
    for i, (axis, still) in enumerate(ways):
        scan = Scan(axis, grids[axis][0], grids[axis][-1], SWEEP_SHARE * machine.limits[machine.axis_index(axis)].speed, still, sweeps=2)
        sweeps.append(recorded(possible_scan(machine, scan)[0], 700 + 100 * seed + i))
    return design_observer(machine, responses, standing, tuned_on, sweeps, modes=modes)


def axis_grid(machine: Machine, axis: int, count: int) -> list[float]:
    """Return positions of one axis over its range [rad or m], closer together towards the ends.

    They are Chebyshev points of the arc, for trigonometric polynomials, stretched to reach its ends: between equidistant points the
    polynomials oscillate, most near the ends.
    """
    limit = machine.limits[axis]
    is_bounded = bool(np.isfinite([limit.lower, limit.upper]).all())
    low, high = (limit.lower + JOG_ROOM, limit.upper - JOG_ROOM) if is_bounded else (-1.0, 1.0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if half >= np.pi:
        return [float(position) for position in np.linspace(low, high, count)]
    points = -np.cos((np.arange(count) + 0.5) * np.pi / count) / np.cos(0.5 * np.pi / count)
    return [float(position) for position in middle + 2.0 * np.arcsin(np.sin(0.5 * half) * points)]
