"""Whether an axis's channels belong together: units, signs, axes and shifts, weighed against each other.

Witnesses are what one channel should be by another: a position by its reference and by the other encoder, a speed by the position, a
current by its command, and efforts by the motion through the machine file's rigid equation. Every error of a recording that is known is
undone in turn, and costs what witnesses then deny; the cheapest stands if it is far cheaper than none. Motions and efforts pass one
low-pass; only their gross features are asked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, replace
from types import ModuleType
from typing import NamedTuple, TypeVar

import numpy as np
import scipy.signal

from hil.diagnosis.audit.alike import EARLY_ROWS, LATEST_S, balanced, fastest_Hz, follows, running
from hil.diagnosis.audit.laws import OF_SPEEDS, of_efforts, of_positions
from hil.diagnosis.audit.readings import FEWEST_ROWS, Fault
from hil.machine import Machine
from hil.recording import Recording
from hil.simulation.control_laws import DIGITS
from virtual_bus.inverse_dynamics import along_module
from virtual_bus.plant.compiled import CompiledPlant, compile_plant

PRICE = 30.0
"""In twice the log likelihood, by which an error must explain more than none: odds of 3e6 for it, for some 60 errors that are tried."""
NEAR = 6.0
"""Of another error, by which it may be behind and is said, too: odds of twenty."""
AGAINST = 60.0
"""Of a witness that says the opposite sign, as far as it is sure: twice PRICE, as for a gain that is off by 7.7 of its widths."""
WIDTHS = {"tracking": 0.3, "encoders": 0.1, "speed": 0.2, "current": 0.35}
"""Standard deviations of the logarithm of a sound ratio: a loop tracks to a third below its bandwidth, gears err by a tenth, windings and
low passes by a third (a speed's by less)."""
OF_NUMBERS = 0.45, 0.67
"""The same of effort over what the motion takes by the file's numbers: they err by a factor of three at two to three deviations; by another
factor of two where the file gives the drive no rotor, which a joint behind a gear feels many times over."""
ALIKE = 0.9
"""Correlation from which a channel is said to follow another one: gains are then known to a tenth."""
NOTHING = 0.3
"""Correlation below which it does not."""
MOST_NOISE = 2.0
"""Of a current's deviation over its command's: one that followed it, with noise, would have a correlation of a half."""
INDEPENDENT = 30.0
"""Samples that a motion counts for at most: nominal equations err by far more than noise."""
UNEXPLAINED, RIGHT = 0.3, 0.01
"""Share of an effort's power from which a motion does not explain it, more or less of it alike; and below which it explains all."""
AGREES = 9.0
"""Against a gain, up to which the file agrees with it: three deviations."""
ROOM = 3.0
"""Of the frequency that has nearly all of the speed's power below it: what the low-pass keeps."""
MOST_ROWS, PER_CYCLE = 6000, 10.0
"""Of the low-passed motion, and at least so many a period of its highest frequency."""
SHIFTS_S = (0.13, 0.17, 0.22, 0.28, 0.36, 0.46)
"""Between motion and efforts that are tried: each is within an eighth of any shift from LATEST_S to half a second."""
MOVES = 50.0
"""Lattice steps that a motion has at least to be one."""
FAULTS = 3
"""Of one recording that are said at most."""


_View = TypeVar("_View", bound="_Even")


@dataclass(frozen=True, eq=False)
class _Even:
    """One recording on even rows: values (N,) by kind and axis."""

    period_s: float
    values: Mapping[tuple[str, str], np.ndarray]
    names: Mapping[tuple[str, str], str]


@dataclass(frozen=True, eq=False)
class _Slow(_Even):
    """The same low-passed, on fewer rows, with the axes that move and how many independent samples their motion has."""

    moving: frozenset[str]
    samples: float


class _Balance(NamedTuple):
    """Of one axis: what its equation says against the effort in all, and against its gain; and whether that gain is believed."""

    cost: float
    denied: float
    is_sure: bool


@dataclass(frozen=True)
class _Error:
    """What is undone: a factor of some channels, an exchange of two axes' channels, or a shift [s] of some."""

    channels: tuple[tuple[str, str], ...]
    said: str
    factor: float = 1.0
    other: str = ""
    late_s: float = 0.0

    def undone(self, even: _View) -> _View:
        """Return the recording without the error."""
        values = dict(even.values)
        for kind, axis in self.channels:
            if (kind, axis) not in values:
                continue
            own = values[kind, axis]
            if self.other:
                values[kind, axis] = even.values[kind, self.other]
                values[kind, self.other] = own
            elif self.late_s:
                values[kind, axis] = np.roll(own, -round(self.late_s / even.period_s))
            else:
                values[kind, axis] = own / self.factor
        return replace(even, values=values)


def belonging_faults(machine: Machine, label: str, recording: Recording, lawful: Set[str]) -> list[Fault]:
    """Return the units, signs, axes and shifts by which a recording's channels do not belong together.

    Of axes whose controller's law is exact as it was recorded, reference, position and command are beyond doubt.
    """
    even = _even(machine, recording)
    if even is None:
        return []
    weighing = _Weighing(machine, lawful)
    slow = weighing.slow(even)
    found: list[Fault] = []
    while len(found) < FAULTS:
        against = weighing.against(even, slow)
        gains = [(weighing.gain(error, even, slow, against), error) for error in _errors(machine, even, lawful)]
        gain, error = max(gains, key=lambda pair: pair[0], default=(0.0, None))
        if error is None or gain < PRICE:
            break
        near = [one.said for other, one in gains if other > gain - NEAR and len(one.channels) == 1 and one.channels != error.channels]
        said = " (or else ".join([error.said, *near[:1]]) + (")" if near else "")
        found.append(Fault(label, even.names[error.channels[0]], False, f"{label}: {said}"))
        even, slow = error.undone(even), None if slow is None else error.undone(slow)
    return found or [Fault(label, name, False, f"{label}: {said}") for name, said in weighing.strangers(even, slow)]


def _even(machine: Machine, recording: Recording) -> _Even | None:
    """Return the channels on even rows, gaps bridged; None where hardly anything was recorded."""
    time = recording.time
    period = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    rows = np.arange(time[0], time[-1], period) if period > 0.0 else time
    if not 4 * FEWEST_ROWS <= len(rows) <= 10 * len(time):
        return None
    values, names = {}, {}
    kinds = ("reference", "position", "link_position", "speed", "current", "effort", "command")
    for kind, axis in ((kind, axis) for kind in kinds for axis in machine.axes):
        name = f"{kind}_{axis}"
        there = np.isfinite(recording[name]) if name in recording else np.zeros(1, dtype=bool)
        if there.sum() > 2 * FEWEST_ROWS:
            key = "current" if kind == "effort" else kind, axis
            values[key], names[key] = np.interp(rows, time[there], recording[name][there]), name
    return _Even(period, values, names)


def _errors(machine: Machine, even: _Even, lawful: Set[str]) -> Iterator[_Error]:
    """Yield every error that may be undone."""
    has = even.values
    for axis in machine.axes:
        is_free = axis not in lawful
        motion = tuple((kind, axis) for kind in ("position", "link_position", "reference", "speed") if (kind, axis) in has)
        efforts = tuple((kind, axis) for kind in ("command", "current") if (kind, axis) in has)
        doubted: list[tuple[tuple[str, str], ...]] = [
            (channel,) for channel in (*motion, *efforts) if is_free or channel[0] in ("link_position", "speed", "current")
        ]
        doubted += [group for group in (motion, efforts) if is_free and len(group) > 1]
        for group in doubted:
            factors = of_efforts(machine, axis) if group[0] in efforts else of_positions(machine, axis)
            for factor, unit in (OF_SPEEDS if group[0][0] == "speed" else factors).items():
                yield _Error(
                    group, f"{_names(even, group)} {unit}: {factor:.4g} times what the other channels and the machine file say", factor
                )
        if is_free and efforts and ("position", axis) in has:
            for late in SHIFTS_S:
                how = f"late: about {1e3 * late:.3g} ms ({round(late / even.period_s)} rows) behind"
                yield _Error(efforts, f"{_names(even, efforts)} {how} the motion that they cause", late_s=late)
                yield _Error(motion, f"{_names(even, motion)} {how} the efforts", late_s=late)
    for number, axis in enumerate(machine.axes):
        for other in machine.axes[number + 1 :]:
            if {axis, other} & lawful:
                continue
            for kinds in (("position",), ("current",), ("command", "current"), ("reference",)):
                both = [(kind, axis) for kind in kinds if (kind, axis) in has and (kind, other) in has]
                if both:
                    pairs = " and ".join(f"{even.names[kind, axis]} and {even.names[kind, other]}" for kind, _ in both)
                    yield _Error(tuple(both), f"{pairs} are exchanged: each axis has the other one's values", other=other)
    every = tuple(key for key in has if key[0] in ("position", "link_position", "reference"))
    if not lawful and len(machine.axes) > 1:
        for factor, unit in of_positions(machine, machine.axes[0]).items():
            yield _Error(every, f"all positions are {unit}: {factor:.4g} times what efforts and the machine file say", factor)


def _names(even: _Even, channels: tuple[tuple[str, str], ...]) -> str:
    return " and ".join(even.names[channel] for channel in channels) + (" are" if len(channels) > 1 else " is")


class _Weighing:
    """What the witnesses of one machine say against a recording."""

    def __init__(self, machine: Machine, lawful: Set[str]) -> None:
        self.machine = machine
        self.lawful = lawful
        self._rigid: tuple[CompiledPlant, ModuleType] | None = None
        settings = machine.plant
        self._joints = [joint.name for joint in settings.tree.joints]
        self._encoders = {encoder.channel: encoder for encoder in settings.encoders}
        reads = {channel: set(encoder.joints) for channel, encoder in self._encoders.items()}
        own = {drive.axis: {drive.joint} for drive in settings.drives}
        self._read_twice = {axis for axis in own if own[axis] <= reads.get(f"link_position_{axis}", set())}
        reach = {limits.axis: max(abs(limits.lower), abs(limits.upper)) for limits in machine.limits}
        self._reach = {axis: value for axis, value in reach.items() if np.isfinite(value)}

    def against(self, even: _Even, slow: _Slow | None) -> tuple[float, dict[str, _Balance]]:
        """Return what ratios deny, and what the rigid equation says of each axis's effort."""
        return self._denied_ratios(even), {} if slow is None else self._dynamics(slow)

    def gain(self, error: _Error, even: _Even, slow: _Slow | None, against: tuple[float, dict[str, _Balance]]) -> float:
        """Return by how much twice the log likelihood rises when an error is undone; `against` is what stands against the recording.

        Where efforts then say nothing any more, or something that the file still denies, they do not count. Springs and gravity that the
        file lacks may explain a recording as it is, and none that has an error: one of both is wrong.
        """
        denied, before = against
        rise = denied - self._denied_ratios(error.undone(even))
        if slow is not None:
            after = self._dynamics(error.undone(slow), with_springs=False)
            touched = {axis for _, axis in error.channels} | {error.other} - {""}
            sure = {axis for axis in touched & after.keys() if after[axis].is_sure and after[axis].denied < AGREES}
            says = bool(sure) and all(axis in sure for axis in touched & before.keys() if before[axis].is_sure)
            change = sum(before[axis].cost - after[axis].cost for axis in touched & before.keys() & after.keys())
            rise += change if says else min(change, 0.0)
        return rise

    def _denied_ratios(self, even: _Even) -> float:
        return sum(_denied(ratio, width) for ratio, width in self._ratios(even))

    def _ratios(self, even: _Even) -> Iterator[tuple[float, float]]:
        """Yield ratios that should be one, with their widths."""
        has = even.values
        for axis in self.machine.axes:
            position = has.get(("position", axis))
            if position is not None and axis in self._reach:
                yield max(float(np.abs(position).max()) / self._reach[axis], 1.0), WIDTHS["tracking"]
            pairs = (("position", "reference", "tracking"), ("link_position", "position", "encoders"), ("current", "command", "current"))
            for kind, of, width in pairs:
                if (kind, axis) in has and (of, axis) in has and (kind != "link_position" or axis in self._read_twice):
                    gain, alike, _ = follows(has[kind, axis], has[of, axis], even.period_s)
                    if alike > ALIKE:
                        yield gain, WIDTHS[width]
            if (speed := has.get(("speed", axis))) is not None and position is not None:
                travel = scipy.signal.detrend(np.cumsum(speed) * even.period_s)
                gain, alike, _ = follows(travel, scipy.signal.detrend(position), even.period_s)
                if alike > ALIKE:
                    yield gain, WIDTHS["speed"]

    def _dynamics(self, slow: _Slow, with_springs: bool = True) -> dict[str, _Balance]:
        """Return what the rigid equation says of each axis's effort."""
        found = {}
        for axis, given, needed, position, speed in self._efforts(slow):
            left, gain, is_believed = balanced(given, needed, position, speed, with_springs)
            unexplained = slow.samples * float(np.log(np.clip(left, RIGHT, UNEXPLAINED) / UNEXPLAINED))
            drive = next(drive for drive in self.machine.plant.drives if drive.axis == axis)
            joint = self.machine.plant.tree.joints[self._joints.index(drive.joint)]
            is_sure = left < UNEXPLAINED and is_believed
            denied = _denied(gain, OF_NUMBERS[joint.armature == 0.0]) if is_sure else 0.0
            found[axis] = _Balance(unexplained + denied, denied, is_sure)
        return found

    def strangers(self, even: _Even, slow: _Slow | None) -> Iterator[tuple[str, str]]:
        """Yield the channels that have nothing to do with those that they should follow."""
        has = even.values
        for axis in self.machine.axes:
            if ("current", axis) in has and ("command", axis) in has:
                current, command, name = has["current", axis], has["command", axis], even.names["current", axis]
                _, alike, late = follows(current, command, even.period_s)
                if alike > ALIKE and not -EARLY_ROWS * even.period_s <= late <= LATEST_S:
                    how = f"{1e3 * abs(late):.3g} ms ({abs(round(late / even.period_s))} rows) {'late' if late > 0.0 else 'early'}"
                    yield name, f"{name} is {how} beside command_{axis}"
                alike = max(alike, follows(current, np.abs(command), even.period_s)[1])
                if alike < NOTHING and 0.0 < np.std(running(current)) < MOST_NOISE * np.std(running(command)):
                    yield name, f"{name} does not follow command_{axis} (correlation {alike:.2f}): it is of another axis or recording"
        balances = {} if slow is None else self._dynamics(slow)
        for axis, given, needed, position, speed in self._efforts(slow):
            left, gain, _ = balanced(given, needed, position, speed, with_springs=True)
            if left > 1.0 - NOTHING**2 and np.std(needed) > NOTHING * np.std(given) and axis not in self.lawful:
                name = even.names["command" if ("command", axis) in has else "current", axis]
                yield name, f"{name} and position_{axis} are not of one recording: the motion explains {1.0 - left:.0%} of the effort"
            elif gain > 0.0 and balances[axis].denied > PRICE:  # behind a spring a joint's inertia may be negative
                name = even.names["command" if ("command", axis) in has else "current", axis]
                said = f"{name} is {gain:.3g} times what the motion takes by the machine file, which no unit or sign explains"
                yield name, f"{said}: it is another machine's recording, or file"

    def slow(self, even: _Even) -> _Slow | None:
        """Return positions and efforts low-passed, on as many rows as that needs; None where an axis has no position, or none moves."""
        settings = self.machine.plant
        moving, values = [], {}
        for drive in settings.drives:
            encoders = [self._encoders.get(f"{kind}_{drive.axis}") for kind in ("position", "link_position")]
            kinds = [e.channel.removesuffix(f"_{drive.axis}") for e in encoders if e is not None and e.joints == (drive.joint,)]
            kind = next((kind for kind in kinds if (kind, drive.axis) in even.values), None)
            if kind is None:
                return None
            q = values["position", drive.axis] = even.values[kind, drive.axis]
            steps = max((encoder.resolution for encoder in encoders if encoder is not None), default=0.0)
            if np.ptp(even.values.get(("reference", drive.axis), q)) > 0.0 and np.ptp(q) > MOVES * steps:
                moving.append(drive.axis)
            for source in ("command", "current"):
                if (source, drive.axis) in even.values:
                    values[source, drive.axis] = even.values[source, drive.axis]
        fastest = max((fastest_Hz(values["position", axis], even.period_s) for axis in moving), default=0.0)
        if fastest <= 0.0:
            return None
        corner = min(ROOM * fastest, 0.1 / even.period_s)
        sections = scipy.signal.butter(3, 2.0 * corner * even.period_s, output="sos")
        every = max(1, int(1.0 / (PER_CYCLE * corner * even.period_s)))
        edge = min(round(1.0 / (corner * even.period_s)), len(q) // 4)

        def passed(signal: np.ndarray) -> np.ndarray:
            return np.asarray(scipy.signal.sosfiltfilt(sections, signal)[edge : len(signal) - edge : every][:MOST_ROWS])

        filtered = {key: passed(value) for key, value in values.items()}
        if len(passed(q)) < FEWEST_ROWS:
            return None
        samples = min(INDEPENDENT, 2.0 * fastest * len(q) * even.period_s)
        return _Slow(every * even.period_s, filtered, even.names, frozenset(moving), samples)

    def _efforts(self, slow: _Slow | None) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Yield each moving axis with its effort, what the motion takes by the file, position and speed, all low-passed (M,)."""
        if slow is None:
            return
        settings = self.machine.plant
        if self._rigid is None:
            plant = compile_plant(replace(settings, substeps=1, effects=()))
            self._rigid = plant, along_module(plant)
        plant, module = self._rigid
        model = plant.model(None, ())
        rows = len(next(iter(slow.values.values())))
        q, v, a, needed = (np.zeros((rows, len(self._joints))) for _ in range(4))
        for drive in settings.drives:
            joint = self._joints.index(drive.joint)
            q[:, joint] = slow.values["position", drive.axis]
            v[:, joint] = np.gradient(q[:, joint], slow.period_s)
            a[:, joint] = np.gradient(v[:, joint], slow.period_s)
        module.efforts(model, plant.new_work(), q, v, a, needed)
        gains = plant.drive_gains(model, q[0])
        for number, drive in enumerate(settings.drives):
            source = next((slow.values[kind, drive.axis] for kind in ("command", "current") if (kind, drive.axis) in slow.values), None)
            if source is not None and drive.axis in slow.moving and np.ptp(source) > DIGITS * np.abs(source).max():
                joint = self._joints.index(drive.joint)
                yield drive.axis, gains[number] * source, needed[:, joint], q[:, joint], v[:, joint]


def _denied(ratio: float, width: float) -> float:
    """Return what a ratio that should be one costs."""
    return float((np.log(max(abs(ratio), 1e-12)) / width) ** 2 + (AGAINST if ratio < 0.0 else 0.0))
