"""Recordings beside their free-run simulation: repeats grouped, channels chosen, residuals.

Repeats are recordings of the same reference, excitation (or command) and start pose, whatever an observer's damping added and however near
to that pose they stood; where none was asked for, their first readings are near each other. One simulation answers all of them. A periodic
recording without repeats is split into its periods instead, and its simulation is averaged over them.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.signal

from hil.diagnosis.recorded.dropout import Dropout, by_sensor, without_lost_samples
from hil.diagnosis.recorded.lattice import Lattice, coarser_lattices, with_lattices
from hil.diagnosis.recorded.repeated import Member, are_repeats, from_mean_start, why_no_repeats
from hil.diagnosis.residuals.carried import carried_imu
from hil.diagnosis.residuals.loop_lattices import loop_lattices
from hil.diagnosis.residuals.noise import NoiseModel, noise_model
from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.diagnosis.residuals.shared_rounding import shared_rounding, with_less_rounding
from hil.diagnosis.residuals.usable import (
    LARGEST_MISSING_SHARE,
    channels_in_common,
    check_periods,
    check_units,
    check_usable,
    missing_share,
    settled_rows,
    that_differ,
    warn_of_a_first_period,
    warn_of_feedforward,
    warn_of_motion_at_the_start,
)
from hil.errors import MachineFileError, RecordingError
from hil.machine import Machine
from hil.machine.load import machine_from_text
from hil.recording import Recording, RecordingWarning
from hil.simulation import Simulator, inputs_of
from hil.simulation.simulate import RATE_TOLERANCE
from hil.simulation.smooth import channel_outputs
from virtual_bus.settings import EffectSetting

SPEED_WINDOW_s = 0.05
"""Length of the local parabola that speeds are taken from: longer than an encoder's steps, shorter than what a joint can reverse in."""


@dataclass(frozen=True, eq=False)
class Mismatch:
    """Every group of repeats beside its simulation, in the same channels.

    `noise` whitens residuals: `noise.of_mean(group.repeats).whiten(residual, group.imu)` takes (N, C) and gives numbers of unit variance
    for one repeat's noise.
    `noise.std` (C,) is the noise's rms per channel. `lost` says which channels (or the IMU as a whole) repeat readings, by the group that
    shows it most clearly; `measured` is without these. `lattices` are those of encoders that are coarser than the machine file's.
    """

    machine: Machine
    channels: tuple[str, ...]
    units: tuple[str, ...]
    groups: tuple[RepeatGroup, ...]
    noise: NoiseModel
    lost: Mapping[str, Dropout] = field(default_factory=dict)
    lattices: Mapping[str, Lattice] = field(default_factory=dict)

    @property
    def read_off(self) -> tuple[tuple[str, Dropout | Lattice], ...]:
        """What the recordings show by themselves and is not known: where, and what."""
        known = {(one.name, one.at) for one in self.machine.plant.effects}
        shown: tuple[tuple[str, Dropout | Lattice], ...] = (*self.lost.items(), *self.lattices.items())
        return tuple((channel, what) for channel, what in shown if (what.setting(channel).name, channel) not in known)

    @property
    def axes(self) -> tuple[str, ...]:
        return self.machine.axes

    def with_simulated(self, simulated: Sequence[np.ndarray]) -> Mismatch:
        """The same recordings beside other simulations, one (N, C) per group."""
        return replace(self, groups=tuple(replace(group, simulated=rows) for group, rows in zip(self.groups, simulated, strict=True)))


def mismatch(
    machine: Machine,
    recordings: Mapping[str, Recording],
    *,
    channels: Sequence[str] | None = None,
    noise: NoiseModel | None = None,
    effects: Sequence[EffectSetting] | None = None,
) -> Mismatch:
    """Group recordings into repeats and simulate each group.

    Parameters
    ----------
    machine : Machine
    recordings : mapping of str to Recording
        By the name they are reported under; aligned: this machine's units, signs and sample rate.
    channels : sequence of str, optional
        As chosen for other recordings of the same diagnosis; found here otherwise.
    noise : NoiseModel, optional
        As estimated from other recordings of the same diagnosis; estimated here otherwise.
    effects : sequence of EffectSetting, optional
        The machine's own by default.

    Raises
    ------
    RecordingError
        No recording, no channel in common with the simulation, a recording without one of `channels`, or a simulation cannot be driven by
        a recording.
    BadAnswerError
        The simulation diverged.

    Warns
    -----
    RecordingWarning
        Where a channel is left out because some of the recordings lack it, where a recording is no repeat of another because of few rows of
        its inputs, and where a recording's own machine file gives no controller to simulate it under.
    """
    if not recordings:
        raise RecordingError("no recording to diagnose; give at least one")
    _warn_of_controllers(machine, recordings)
    drawn = [_drawn(group, effects) for group in _grouped(machine, recordings)]
    chosen = channels_in_common(machine, drawn) if channels is None else tuple(channels)
    for members, _ in drawn:
        for member in members:
            check_usable(member, chosen)
            check_units(machine, member.label, member.recording, chosen)
            check_periods(member)
            settled_rows(member)
    warn_of_feedforward(drawn)
    warn_of_motion_at_the_start(machine, drawn)
    made = tuple(_group(group, simulated, chosen) for group, simulated in drawn)
    if channels is None and noise is None and (live := that_differ(machine, made, chosen)) != chosen:
        chosen, made = live, tuple(_group(group, simulated, live) for group, simulated in drawn)
    for (members, _), group in zip(drawn, made, strict=True):
        if len(group.windows) == group.repeats > len(members):
            warn_of_a_first_period(members[0], group.measured)
    channels = chosen
    lattices = coarser_lattices(machine, channels, [group.measured for group in made])
    lost: dict[str, Dropout] = {}
    for number, group in enumerate(made):
        kept, found = without_lost_samples(group.measured, group.simulated, channels)
        lost |= {at: one for at, one in found.items() if at not in lost or one.clarity > lost[at].clarity}
        if found:
            made = (*made[:number], group.without(kept), *made[number + 1 :])
    first = next(iter(recordings.values()))
    units = tuple(first.channel(name).unit for name in channels)
    if noise is None:
        floor = with_lattices(machine, lattices, max(group.repeats for group in made))
        rounding, shares = shared_rounding(made, channels, lattices)
        noise = noise_model(made, channels, with_less_rounding(floor, shares), [*loop_lattices(made, channels), *rounding])
    return Mismatch(machine, channels, units, made, noise, by_sensor(lost), lattices)


def _drawn(group: list[Member], effects: Sequence[EffectSetting] | None) -> tuple[list[Member], dict[str, np.ndarray]]:
    """The group and its simulated channels, from where its runs stood on average.

    An observer's damping answers to each run's own noise: repeats differ in it. The group is simulated under its mean, and what its
    deviation does to a repeat, by the nominal simulation, is taken out of that repeat.
    """
    machine, first = group[0].machine, from_mean_start(group)
    simulator = Simulator(machine)
    if all(member.inputs is member.planned for member in group) or len(group) == 1:
        return [replace(member, inputs=first) for member in group], channel_outputs(machine, simulator.run(first, effects=effects))
    first = replace(first, excitation=np.mean([member.inputs.excitation for member in group], axis=0))
    mean = channel_outputs(machine, simulator.run(first, effects=effects))
    under_own = []
    for member in group:
        own = channel_outputs(machine, simulator.run(replace(first, excitation=member.inputs.excitation), effects=effects))
        under_own.append(replace(member, inputs=first, damped={name: own[name] - mean[name] for name in mean}))
    return under_own, mean


def _undamped(recording: Recording) -> Recording:
    """Without the channels of an observer's damping; itself where it has none."""
    kept = {name: channel for name, channel in recording.channels.items() if not name.startswith("damping_")}
    return recording if len(kept) == len(recording.channels) else Recording(kept, recording.metadata)


def _grouped(machine: Machine, recordings: Mapping[str, Recording]) -> list[list[Member]]:
    """Recordings of the same experiment together, in the order given."""
    machines = {machine.hash: machine, "": machine}
    groups: list[list[Member]] = []
    for label, recording in recordings.items():
        own = machines.setdefault(recording.machine_hash, _with_controller_of(machine, recording))
        try:
            inputs, plain = inputs_of(own, recording), _undamped(recording)
            member = Member(label, recording, own, inputs, inputs if plain is recording else inputs_of(own, plain))
        except RecordingError as problem:
            raise RecordingError(f"{label}: {problem}") from None
        for group in groups:
            if group[0].machine is own and are_repeats(group[0], member):
                group.append(member)
                break
        else:
            _warn_of_near_repeats(member, groups)
            groups.append([member])
    return groups


def _warn_of_near_repeats(member: Member, groups: list[list[Member]]) -> None:
    """Of a recording that opens a group of its own, in a line: few rows alone keep it from being a repeat."""
    for group in groups:
        if why := why_no_repeats(member, group[0]):
            words = f"{member.label}: no repeat of {group[0].label}: {why}; taken for another experiment, they show no noise together"
            warnings.warn(words, RecordingWarning, stacklevel=4)
            return


def _with_controller_of(machine: Machine, recording: Recording) -> Machine:
    """The diagnosed machine under the controller a recording was made with, as far as the recording carries it."""
    own, _ = _own_machine(machine, recording)
    return machine if own is None else replace(machine, controllers=own.controllers)


def _own_machine(machine: Machine, recording: Recording) -> tuple[Machine | None, str]:
    """The machine file in a recording, where it says with which controller of the diagnosed machine's axes it was made; else None, and
    why the diagnosed machine's is used instead: "" where it is that machine, none is carried or none is used.
    """
    if not recording.machine_text or recording.machine_hash == machine.hash:
        return None, ""
    try:
        own = machine_from_text(recording.machine_text, label="its own machine file")
    except MachineFileError as problem:
        return None, str(problem) if machine.controllers else ""
    as_fast = abs(own.sample_rate_Hz / machine.sample_rate_Hz - 1.0) <= RATE_TOLERANCE
    if own.axes == machine.axes and bool(own.controllers) == bool(machine.controllers) and (as_fast or not own.controllers):
        return own, ""
    if not machine.controllers:
        return None, ""
    if own.axes == machine.axes and own.controllers:
        return None, f"its own machine file {own.name} runs at {own.sample_rate_Hz:g} Hz, and its controller at no other rate"
    lacks = f"its axes are {', '.join(own.axes)}" if own.axes != machine.axes else "it has no controller"
    return None, f"its own machine file {own.name}: {lacks}"


def _warn_of_controllers(machine: Machine, recordings: Mapping[str, Recording]) -> None:
    """Say in a line which recordings are simulated under the diagnosed machine's controller for lack of their own."""
    labels: dict[str, list[str]] = {}
    for label, recording in recordings.items():
        if why := _own_machine(machine, recording)[1]:
            labels.setdefault(why, []).append(label)
    for why, own in labels.items():
        words = f"{', '.join(own)}: simulated under the controller of {machine.name}; {why}"
        warnings.warn(words, RecordingWarning, stacklevel=3)


def _group(members: Sequence[Member], simulated: Mapping[str, np.ndarray], channels: tuple[str, ...]) -> RepeatGroup:
    machine, inputs, recording = members[0].machine, members[0].inputs, members[0].recording
    measured = np.stack([member.measured(channels) for member in members])
    rows = np.column_stack([simulated[name] for name in channels])
    labels = tuple(member.label for member in members)
    windows: tuple[slice, ...] = (slice(0, len(rows)),)
    if len(members) == 1 and recording.experiment.get("period_samples"):
        periods = [part for part in _whole_periods(recording) if np.isnan(measured[0, part]).mean(axis=0).max() <= LARGEST_MISSING_SHARE]
        if len(periods) > 1:
            windows = tuple(periods)
            labels = tuple(f"{labels[0]} period {number}" for number in range(1, len(periods) + 1))
            measured = np.stack([measured[0, window] for window in windows])
    elif settle_rows := settled_rows(members[0]):
        windows = (slice(settle_rows, len(rows)),)
        measured = measured[:, settle_rows:]
    time_s = recording.time[windows[0]]
    places = [_position_channel(axis, members, simulated) for axis in machine.axes]
    positions = _bins(members, windows, places, simulated)
    measures = [f"{'current' if units.effort == 'A' else 'effort'}_{units.axis}" for units in machine.units]
    efforts = [name if name in recording or name in simulated else f"command_{name.split('_', 1)[1]}" for name in measures]
    window_rows = max(5, 2 * round(0.5 * SPEED_WINDOW_s * machine.sample_rate_Hz) + 1)
    speed = _bins(members, windows, [f"speed_{axis}" for axis in machine.axes], simulated)
    encoded = np.array([name in simulated for name in places])
    if len(positions) > window_rows:
        slope = scipy.signal.savgol_filter(positions, window_rows, 2, deriv=1, delta=1.0 / machine.sample_rate_Hz, axis=0)
        speed = np.where(encoded, slope, speed)
    return RepeatGroup(
        labels=labels,
        machine=machine,
        inputs=inputs,
        windows=windows,
        time_s=time_s,
        measured=measured,
        simulated=np.mean([rows[window] for window in windows], axis=0),
        position=positions,
        speed=speed,
        effort=_bins(members, windows, efforts, simulated),
        reference=positions if inputs.reference is None else inputs.reference[windows[0]],
        imu=carried_imu(machine, channels, positions),
    )


def _whole_periods(recording: Recording) -> tuple[slice, ...]:
    try:
        return recording.period_slices
    except RecordingError:
        return ()


def _position_channel(axis: str, members: Sequence[Member], simulated: Mapping[str, np.ndarray]) -> str:
    """The encoder an axis's motion is taken from: the motor's, else the link's, and where neither is recorded the one that is simulated."""
    names = (f"position_{axis}", f"link_position_{axis}")
    recorded = (n for n in names if all(missing_share(member.recording, n) <= LARGEST_MISSING_SHARE for member in members))
    return next(recorded, None) or next((n for n in names if n in simulated), names[0])


def _bins(members: Sequence[Member], windows: Sequence[slice], names: Sequence[str], simulated: Mapping[str, np.ndarray]) -> np.ndarray:
    """(N, len(names)) mean over repeats and windows of what was measured; simulated where it was not or where samples are missing."""
    columns = []
    for name in names:
        stand_in = simulated.get(name, np.zeros(members[0].recording.rows))
        found = [member.recording[name] if name in member.recording.channels else stand_in for member in members]
        values = [np.where(np.isfinite(column), column, stand_in) for column in found]
        columns.append(np.mean([value[window] for value in values for window in windows], axis=0))
    return np.column_stack(columns)
