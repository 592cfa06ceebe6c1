"""Design of an observer: model from frequency responses, gravity from standing records, noise from records, disturbances by tuning."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from controllers.models.modal import ModalModel
from controllers.observers.modal_observer import FilterKind, ModalObserver
from controllers.observers.settings import ObserverNoise
from hil.errors import UnusableInputError
from hil.identification import FrequencyResponse
from hil.machine import Machine
from hil.observing.directions import with_directions
from hil.observing.geometry import observed_chain
from hil.observing.gravity_at_rest import standing_mean, with_gravity, with_gravity_at_places
from hil.observing.held_to_truth import held_to_truth, scaled
from hil.observing.last_mode import with_last_mode
from hil.observing.noise import effort_gain, starting_noise, stated_noise
from hil.observing.over_poses import axis_grid, fit_observed_model, harmonics_for, untold_note
from hil.observing.own_model import own_model
from hil.observing.sag import sagging, with_sag
from hil.observing.structure import Structure, found_structure, with_coupling, with_inertia, with_places
from hil.observing.tuning import tune
from hil.observing.turning import with_turning
from hil.observing.unmodelled import with_unmodelled, without_counted
from hil.observing.unseen import Unseen, scans_of, unseen
from hil.recording import Recording

GRID, COARSE_GRID = 13, 9
"""Poses of the axis nearest to the detector at which a model with the file's numbers is made, and of the others: enough for five and four
harmonics."""


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
    unseen : what its alarm does not see, and how wrong it is then; empty where that is not known
    """

    model: ModalModel
    noise: ObserverNoise
    isocenter_m: np.ndarray
    machine: str
    machine_hash: str
    notes: tuple[str, ...] = field(default=())
    poses: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    unseen: tuple[Unseen, ...] = ()

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
        noise, note = _tuned(model, noise, tuned_on)
        notes.append(note)
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
    """Design an observer for a machine that has not been measured: with the numbers of its file, held to the truth of its emulation.

    Friction, play and sensors' errors of the file are in no modal model: they are counted in the noise, as far as one machine may differ
    from another, and what is stated then is scaled until it is true of emulated machines. The alarm knows from them what is usual, and the
    notes say what it does not see.

    Parameters
    ----------
    machine : Machine
    tuned_on : sequence of Recording
    modes, seed : int
        One mode above `modes` is in the model, too.
    told : callable
        Told how many scans of how many are done.

    Raises
    ------
    UnusableInputError
        The machine's detector cannot be observed.
    ExperimentError
        It can make none of the scans.
    """
    _, _, _, isocenter = observed_chain(machine)
    counts = tuple(GRID if axis == machine.axes[-1] else COARSE_GRID for axis in machine.axes)
    model = own_model(without_counted(machine), modes + 1, counts)
    noise = with_unmodelled(stated_noise(model, machine), model, machine)
    notes = [f"{model.modes} modes, gravity and turning with the numbers of the machine file"]
    if tuned_on:
        noise, note = _tuned(model, noise, tuned_on)
        notes.append(note)
    more = scans_of(machine, model)
    held = held_to_truth(machine, ModalObserver(model, noise, isocenter_m=isocenter), seed, lambda done, of: told(done, of + more))
    noise = replace(scaled(noise, held.factors), usual=held.usual)
    alarming = ModalObserver(model, noise, isocenter_m=isocenter)
    blind = unseen(machine, alarming, seed, lambda done: told(held.scans + done, held.scans + more))
    notes += [*held.notes(), *(each.note for each in blind)]
    ends = [axis_grid(machine, axis, 2) for axis in range(len(machine.axes))]
    return ObserverDesign(model, noise, isocenter, machine.name, machine.hash, tuple(notes), np.array(list(product(*ends))), blind)


def _tuned(model: ModalModel, noise: ObserverNoise, recordings: Sequence[Recording]) -> tuple[ObserverNoise, str]:
    """Return the noise that recordings make most likely, and a note."""
    tuning = tune(model, noise, recordings)
    share = 100.0 * tuning.share_in_band
    return tuning.noise, f"tuned on {len(recordings)} recordings: NIS {tuning.mean_nis:.2f} per measurement, {share:.1f} % in the 95 % band"
