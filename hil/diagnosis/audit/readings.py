"""What one channel shows against itself: readings that are missing, stand still, jump, are cut off, or are no sensor's own."""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import dataclass

import numpy as np

from hil.machine import Machine
from hil.recording import Recording
from hil.simulation.control_laws import command_resolution

MEASURED = ("position", "link_position", "speed", "current", "effort", "command", "reference")
POSITIONS = ("position", "link_position")
FEWEST_ROWS = 50
"""Fewer say nothing about a motion of second order in several joints. What is missing in fewer on end is bridged. Two such stretches are
needed to fit to one and judge by the other."""
SLOW = 4.0
"""Of the machine's rows between two of a recording's: what its command does in between is not known, and matters where the command of one
row says less than half of the next one's."""
BEYOND = 5.0
"""Times the largest step beside it: a motion changes its speed with bounded acceleration, so that its largest steps have neighbours that
are nearly as large. A step of five times its neighbours is none of a motion."""
STEPS = 10.0
"""Lattice steps that a jump or a plateau's edge has at least: rounding makes one or two."""
MOST_JUMPS = 0.01
"""Of the rows: more of them are noise."""
PLATEAU = 5
"""Rows on end of exactly the largest reading. With steps of STEPS lattice steps beside them chance makes so many in less than 1e-4."""
PLATEAUS = 2
"""At one value: a joint that friction stops does not come to rest at the same count twice."""
IN_ONE_CLASS = 0.99
"""Share of a difference's energy in every m-th row, from which the rows between are not measured: of a signal that was read in every row it
is 1/m, give or take a few per cent in FEWEST_PERIODS of them."""
MOST_BETWEEN, FEWEST_PERIODS = 20, 40
SMOOTH = 0.125
"""Of the third difference that rounding to the file's lattice makes of any motion of two steps a row (20/12 of a step squared, Widrow and
Kollar 2008), below which readings were filtered after they were rounded, or never were: half of a quarter, which an encoder has whose lines
are counted four times and whose file does not say so."""
ON_LATTICE = 0.02
"""Steps from a lattice of which the median reading on it is at most: text has so many digits. Of readings on none it is a quarter."""
SMOOTHER = 0.5
"""Ratio of what linear interpolation leaves of readings on even rows to what it leaves at their stamps, from which stamps are wrong."""
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Fault:
    """What is wrong with recordings.

    Attributes
    ----------
    recording, channel : str
    is_lack : bool
        Whether too little was recorded; else it is not what the machine file says.
    said : str
        In one sentence.
    """

    recording: str
    channel: str
    is_lack: bool
    said: str


def channels_of(machine: Machine, recording: Recording) -> list[tuple[str, str, str]]:
    """Return kind, axis and name of the channels of a machine's axes that were recorded."""
    names = [(kind, axis, f"{kind}_{axis}") for axis in machine.axes for kind in MEASURED]
    return [(kind, axis, name) for kind, axis, name in names if name in recording and np.isfinite(recording[name]).any()]


def reading_faults(machine: Machine, label: str, recording: Recording) -> list[Fault]:
    """Return what is wrong with single channels of a recording; of each channel the first thing."""
    found = []
    lattices = {encoder.channel: encoder.resolution for encoder in machine.plant.encoders}
    channels = channels_of(machine, recording)
    moving = [name for _, _, name in channels if np.nanmax(recording[name]) > np.nanmin(recording[name])]
    if channels and not moving:
        return [
            Fault(label, channels[0][2], True, f"{label}: no channel of {machine.name} changes: nothing moves, and nothing is measured")
        ]
    if recording.rows < 2 * FEWEST_ROWS:
        duration_s = recording.time[-1] - recording.time[0]
        said = f"{label}: {recording.rows} rows ({duration_s:.3g} s) are too few: record {2 * FEWEST_ROWS} at least"
        return [Fault(label, "time", True, said)]
    if said := _too_slow(machine, recording):
        return [Fault(label, "time", True, f"{label}: {said}")]
    for kind, axis, name in channels:
        values = recording[name]
        unit = recording.channel(name).unit
        lattice = max(lattices.get(name, 0.0), command_resolution(values[np.isfinite(values)]))
        checks = [_missing(recording, values), _constant(recording, kind, axis, lattice)]
        if kind in POSITIONS:
            checks += [_stuck(recording, axis, values, lattice), _jumps(recording, axis, values, lattice, unit)]
        if kind not in ("reference", "command"):
            checks += [_clipped(recording, name, lattice, unit)]
        if kind in POSITIONS and recording.is_even:
            checks += [_between(values)]
        said = next((said for said in checks if said), "")
        if said:
            found.append(Fault(label, name, "missing" in said, f"{label}: {name} {said}"))
    return found


def _too_slow(machine: Machine, recording: Recording) -> str:
    """Say that rows are too far apart for commands that change from row to row."""
    between = float(np.median(np.diff(recording.time))) * machine.sample_rate_Hz
    for name in (f"command_{axis}" for axis in machine.axes if f"command_{axis}" in recording):
        command = recording[name] - np.nanmean(recording[name])
        alike = float(np.nanmean(command[1:] * command[:-1]) / max(np.nanmean(command**2), 1e-300))
        if between > SLOW and np.nanmax(np.abs(command)) > 0.0 and alike < 0.5:
            rate = f"one row in {between:.3g} of {machine.name}'s"
            return f"sampled too slowly: {rate}, while {name} changes from row to row (correlation {alike:.2f}): record every row"
    return ""


def _runs(is_in: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield first and behind-last rows of the stretches in which something holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_in, [False]]).astype(int)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _between_times(recording: Recording, begin: int, end: int) -> str:
    return f"from {recording.time[begin]:.4g} to {recording.time[min(end, recording.rows) - 1]:.4g} s"


def _missing(recording: Recording, values: np.ndarray) -> str:
    there = np.flatnonzero(np.isfinite(values))
    usual = float(np.median(np.diff(there))) if len(there) > 1 else 1.0
    longest = max(_runs(~np.isfinite(values)), key=lambda run: run[1] - run[0], default=(0, 0))
    if longest[1] - longest[0] < FEWEST_ROWS * usual:
        return ""
    share = float(np.mean(~np.isfinite(values)))
    return f"is missing {_between_times(recording, *longest)}, {share:.0%} of its rows in all: leave these rows out, or record again"


def _constant(recording: Recording, kind: str, axis: str, lattice: float) -> str:
    """Say that a sensor reads the same all the time, while what it follows moves."""
    name = f"{kind}_{axis}"
    values = recording[name]
    follows = {"position": ("reference", "link_position"), "link_position": ("reference", "position"), "current": ("command",)}
    if np.nanmax(values) > np.nanmin(values):
        return ""
    for other in (f"{each}_{axis}" for each in follows.get(kind, ())):
        if other in recording and np.nanmax(recording[other]) - np.nanmin(recording[other]) > STEPS * lattice:
            reach = np.nanmax(recording[other]) - np.nanmin(recording[other])
            return f"stays at {values[np.isfinite(values)][0]:.4g} in every row, while {other} changes by {reach:.3g}: a dead channel"
    return ""


def _stuck(recording: Recording, axis: str, values: np.ndarray, lattice: float) -> str:
    """Say where a reading stays the same while the joint moves, and then jumps to where the motion has gone meanwhile.

    Before a step a joint rests. That it moves is shown, by the middle of the stretch, by its reference or another encoder; or by the
    reading itself, which stops from one row to the next.
    """
    steps = np.diff(values)
    others = [recording[name] for name in (f"{kind}_{axis}" for kind in ("reference", *POSITIONS)) if name in recording]
    for begin, end in _runs(steps == 0.0):
        nearby = np.concatenate([np.abs(steps[max(begin - 6, 0) : begin]), np.abs(steps[end + 1 : end + 6])])
        if end - begin < FEWEST_ROWS or end >= len(steps) or not np.isfinite(steps[end]) or not np.isfinite(nearby).any():
            continue
        half = slice(begin, (begin + end) // 2)
        least = max(STEPS * lattice, abs(steps[end]) / STEPS)
        moves = begin > 0 and abs(steps[begin - 1]) > STEPS * lattice
        if not moves and not any(np.ptp(other[half]) > least for other in others):
            continue
        if abs(steps[end]) > max(BEYOND * float(np.nanmax(nearby)), STEPS * lattice):
            return f"stays the same {_between_times(recording, begin, end + 1)} and then jumps: it was stuck"
    return ""


def _jumps(recording: Recording, axis: str, values: np.ndarray, lattice: float, unit: str) -> str:
    """Say where a reading jumps and its reference does not: the few largest steps are far beyond those of all other rows."""
    there = np.flatnonzero(np.isfinite(values))
    steps = np.diff(values[there]) / np.maximum(np.diff(recording.time[there]) / np.median(np.diff(recording.time)), 1.0)
    if len(steps) < FEWEST_ROWS:
        return ""
    order = np.argsort(-np.abs(steps))
    sizes = np.abs(steps[order])
    most = max(2, int(MOST_JUMPS * len(steps)))
    apart = sizes[:most] > np.maximum(BEYOND * sizes[1 : most + 1], STEPS * lattice)
    if not apart.any():
        return ""
    rows = np.sort(order[: int(np.flatnonzero(apart)[-1]) + 1])
    if f"reference_{axis}" in recording:
        asked = np.abs(np.diff(recording[f"reference_{axis}"]))
        rows = rows[[not np.any(asked[max(there[k] - PLATEAU, 0) : there[k + 1] + 1] > 0.5 * abs(steps[k])) for k in rows]]
    if not len(rows):
        return ""
    at, size = recording.time[there[rows[0] + 1]], float(steps[rows[0]])
    count = "" if len(rows) == 1 else f"; {len(rows)} such steps"
    turns = size / TURN
    if len(rows) > 1 and abs(steps[rows].sum()) < 0.5 * np.abs(steps[rows]).sum() and np.diff(rows).min() <= 2:
        return f"has readings that no motion reaches, the first at {at:.4g} s ({size:+.3g} {unit} from the row before{count})"
    how = f"jumps by {size:+.4g} {unit} from one row to the next at {at:.4g} s{count}"
    if unit == "rad" and abs(turns - round(turns)) < 0.01 and round(turns):
        return f"{how}: by {abs(round(turns))} turn{'s' if abs(round(turns)) > 1 else ''}, as a counter that overflows; unwrap it"
    reset = abs(values[there[rows[0] + 1]]) < 0.01 * abs(size)
    return how + (": it was set to zero" if reset else ": it was reset, or rows are missing")


def _clipped(recording: Recording, name: str, lattice: float, unit: str) -> str:
    """Say where a reading is cut off: it arrives at one value and leaves it in steps of many lattice steps, again and again.

    A joint that friction stops stands elsewhere every time. A drive at its limit gives an effort that is cut off, too: it is a reading's
    error only where the command goes on.
    """
    values = recording[name]
    kind, axis = name.split("_", 1)
    beyond = np.ones(len(values), dtype=bool)
    if kind in ("current", "effort"):
        if f"command_{axis}" not in recording:
            return ""
        beyond = np.abs(recording[f"command_{axis}"]) > np.abs(values) + STEPS * lattice
    steps = np.abs(np.diff(values))
    for extreme in (np.nanmax(values), np.nanmin(values)):
        found = []
        for begin, end in _runs(values == extreme):
            if end - begin >= PLATEAU and begin >= 2 and end < len(values) - 1 and beyond[begin:end].mean() > 0.5:
                edges = steps[begin - 2], steps[end]  # the last step before the plateau may be cut itself
                if min(edges) > STEPS * lattice:
                    found.append((begin, end))
        if len(found) >= PLATEAUS:
            rows = sum(end - begin for begin, end in found)
            where = "" if kind in ("current", "effort", "speed") else ", or the machine hit a stop there"
            first = _between_times(recording, *found[0])
            return f"is clipped at {extreme:.5g} {unit}, {len(found)} times, first {first}, in {rows} rows{where}"
    return ""


def _between(values: np.ndarray) -> str:
    """Say that only every m-th row was measured: the others repeat it, or lie on straight lines."""
    there = values[np.isfinite(values)]
    if len(there) < len(values) or np.ptp(there) == 0.0:
        return ""
    for order, said in ((1, "repeats every reading"), (2, "lies on straight lines")):
        energy = np.diff(values, order) ** 2
        if not energy.sum() > 0.0:
            continue
        for m in range(min(MOST_BETWEEN, len(energy) // FEWEST_PERIODS), 1, -1):  # of a divisor of m it is true, too
            by_class = np.array([energy[k::m].sum() for k in range(m)]) / energy.sum()
            busy = max(np.count_nonzero(energy[k::m] > 1e-3 * energy.max()) for k in range(m))
            if by_class.max() > IN_ONE_CLASS and busy >= FEWEST_PERIODS:
                how = "held" if order == 1 else "interpolated"
                return f"{said} between every {m} rows: it was measured {m} times as seldom and {how}"
    return ""


def smooth_faults(machine: Machine, label: str, recording: Recording, lawful: Set[str]) -> list[Fault]:
    """Return the positions that lack the rounding of the file's encoder although they move by more than its steps.

    Where the controller's law gives the command of them exactly they are what it read; where there is none, nothing says that they are not.
    """
    found = []
    for encoder in machine.plant.encoders:
        axis = machine.axis_of_channel(encoder.channel)
        has_loop = {f"reference_{axis}", f"command_{axis}", encoder.channel} <= set(recording.channels)
        if has_loop and axis not in lawful and recording.is_even and _is_smooth(recording[encoder.channel], encoder.resolution):
            step = f"{encoder.resolution:.3g} {recording.channel(encoder.channel).unit}"
            said = f"{label}: {encoder.channel} is smoother than readings in its encoder's steps of {step} can be"
            found.append(Fault(label, encoder.channel, False, f"{said}, and no law gives the command of it: it was filtered or resampled"))
    return found


def _is_smooth(values: np.ndarray, resolution: float) -> bool:
    values = np.where(np.isfinite(values), values, np.nan)
    if resolution <= 0.0 or np.nanmedian(np.abs(values / resolution - np.round(values / resolution))) < ON_LATTICE:
        return False  # on the lattice, where a steady motion may have a whole number of steps a row
    third, fast = np.diff(values, 3), np.minimum(np.abs(np.diff(values))[:-2], np.abs(np.diff(values))[2:]) > 2.0 * resolution
    used = third[fast & np.isfinite(third)]
    rounding = 0.6745 * resolution * np.sqrt(20.0 / 12.0)  # the median size of what is normal with this deviation
    return len(used) >= 4 * FEWEST_ROWS and float(np.median(np.abs(used))) < SMOOTH * rounding


def stamp_fault(machine: Machine, label: str, recording: Recording) -> Fault | None:
    """Return that stamps jitter, where a position is smooth over even rows and not at its stamps."""
    gaps = np.diff(recording.time)
    median = float(np.median(gaps))
    if recording.is_even or len(gaps) < 4 * FEWEST_ROWS:
        return None
    for kind, _, name in channels_of(machine, recording):
        if kind not in POSITIONS:
            continue
        values = recording[name]
        weight = gaps[1:] / (gaps[1:] + gaps[:-1])
        whole = (gaps[1:] < 2.5 * median) & (gaps[:-1] < 2.5 * median) & (gaps[1:] + gaps[:-1] < 3.0 * median)
        even = values[1:-1] - 0.5 * (values[:-2] + values[2:])
        stamped = values[1:-1] - weight * values[:-2] - (1.0 - weight) * values[2:]
        used = whole & np.isfinite(even)
        if used.sum() > 4 * FEWEST_ROWS and np.std(even[used]) < SMOOTHER * np.std(stamped[used]):
            jitter = 1e3 * float(np.std(gaps[gaps < 1.5 * median])) / np.sqrt(2.0)
            said = (
                f"{label}: time stamps jitter by {jitter:.2g} ms, while {name} was read on even rows: it is smooth over rows, not over time"
            )
            return Fault(label, "time", False, f"{said}; give rows {1e3 * np.mean(gaps):.4g} ms apart")
    return None
