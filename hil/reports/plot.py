"""The page of `isocenter plot`: every channel of recordings over time, their simulation over it, and beneath what it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from hil.errors import UnusableInputError
from hil.pages import Chart, Charts, Page, Scale, Section, Series, Table, Text, Verdict
from hil.recording import Recording
from hil.reports.derived import Derived, in_time, spectrum
from hil.reports.made_from import command_line, files_fact, pose_of, recorded_machine, recorded_name, was_emulated
from hil.simulation import compare
from hil.simulation.compare import INPUTS

BOOKKEEPING = ("statusword_", "data_age_", "sync_lateness", "work_time", "imu_time", "imu_counter", "exposure_id", "imu_source_time",
               "imu_source_counter", "answer_time", "own_work_time")  # fmt: skip
"""Beginnings of channels that say how the bench ran, not what the machine did: folded."""

LATE_s = 1000.0
"""A time that begins later than this, such as that of a clock, is shown from the first row on."""

RESIDUAL_PX = 120


@dataclass(frozen=True, eq=False)
class Plotted:
    """A recording, where it was read from, its simulation where there is one, and by how much it is shown later [s]."""

    path: Path
    recording: Recording
    simulation: Recording | None = None
    shift_s: float | None = None


def channels_of(plotted: Sequence[Plotted], patterns: Sequence[str] = ()) -> list[str]:
    """Return the channels to plot, in the recordings' order: all, or those of names or patterns such as `current_*`.

    Raises
    ------
    UnusableInputError
        A pattern fits no channel.
    """
    there = [name for name in dict.fromkeys(name for one in plotted for name in one.recording.channels) if name != "time"]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in there):
            raise UnusableInputError(f"channel {pattern}: there is none; there are {', '.join(there)}")
    return [name for name in there if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)]


def plot_page(plotted: Sequence[Plotted], channels: Sequence[str], derived: Sequence[Derived] = ()) -> Page:
    """Return the page of these channels, and of those that are derived from others."""
    recordings = [one.recording for one in plotted]
    seen = [name for name in channels if _values(plotted, name).size]
    empty = [name for name in channels if name not in seen]
    still = {name: value for name in seen if (value := _constant(plotted, name)) is not None}
    main = [name for name in seen if name not in still and not name.startswith(BOOKKEEPING)]
    rest = [name for name in seen if name not in still and name.startswith(BOOKKEEPING)]
    sections = [Section("Derived channels", [Charts(derived_charts(plotted, derived), columns=2)])] if derived else []
    for title, names, folded in (("Channels", main, False), ("How the bench ran", rest, bool(main))):
        if names:
            sections.append(Section(title, [Charts(charts_of(plotted, names), columns=2)], is_folded=folded))
    if still:
        rows = [(name, f"{value:g} {_unit(plotted, name)}".rstrip()) for name, value in still.items()]
        sections.append(Section("Channels that do not change", [Table(("channel", "value"), rows, frozenset({1}))], is_folded=bool(main)))
    if empty:
        sections.append(Section("Empty channels", [Text(", ".join(empty))], is_folded=True))
    verdict, command, reason = _answer(plotted)
    facts = {"Machine": recorded_machine(recordings) or "not named in the recording", "Files": files_fact([one.path for one in plotted])}
    return Page(_title(plotted), verdict, sections, command, reason, facts, was_emulated(recordings))


def drawn_channels(plotted: Sequence[Plotted], channels: Sequence[str]) -> list[str]:
    """Return of the channels those of which a chart says something: what moved, without the bench's own where there is anything else."""
    moving = [name for name in channels if _values(plotted, name).size and _constant(plotted, name) is None]
    return [name for name in moving if not name.startswith(BOOKKEEPING)] or moving


def charts_of(plotted: Sequence[Plotted], channels: Sequence[str]) -> list[tuple[Chart, ...]]:
    """Return a chart for every channel, each with that of its residual beneath it where there is a simulation."""
    times, label = _times(plotted)
    poses = dict.fromkeys(filter(None, (pose_of(one.recording) for one in plotted)))
    pose = poses.popitem()[0] if len(poses) == 1 else ""
    several = len(plotted) > 1
    stacks = []
    for name in channels:
        unit = f" [{_unit(plotted, name)}]" if _unit(plotted, name) else ""
        series: list[Series] = []
        left: list[Series] = []
        for one, time in zip(plotted, times, strict=True):
            of = f", {one.path.stem}" if several else ""
            if name in one.recording:
                series.append(Series(f"recorded{of}", time, one.recording[name]))
            if one.simulation is not None and name in one.simulation and name in one.recording and not name.startswith(INPUTS):
                series.append(Series(f"simulated{of}", time, one.simulation[name]))
                left.append(Series(f"recorded less simulated{of}", time, one.recording[name] - one.simulation[name], look=2 + len(left)))
        stack = [Chart(name, Scale(label), Scale(name + unit), series, pose=pose, group="time")]
        if left:
            title = f"{name}: recorded less simulated"
            stack.append(Chart(title, Scale(label), Scale("residual" + unit), left, group="time", height=RESIDUAL_PX))
        stacks.append(tuple(stack))
    return stacks


def derived_charts(plotted: Sequence[Plotted], derived: Sequence[Derived]) -> list[tuple[Chart, ...]]:
    """Return a chart for every derived channel, with all recordings in it."""
    times, label = _times(plotted)
    several = len(plotted) > 1
    stacks: list[tuple[Chart, ...]] = []
    for each in derived:
        series, unit = [], ""
        for one, time in zip(plotted, times, strict=True):
            x, channel = spectrum(each, one.recording) if each.kind == "spectrum" else (time, in_time(each, one.recording))
            series.append(Series(one.path.stem if several else "recorded", x, channel.values))
            unit = f" [{channel.unit}]" if channel.unit else ""
        if each.kind == "spectrum":
            stacks.append((Chart(each.text, Scale("frequency [Hz]"), Scale(f"amplitude{unit}", is_log=True), series, group="frequency"),))
        else:
            stacks.append((Chart(each.text, Scale(label), Scale(each.text + unit), series, group="time"),))
    return stacks


def _unit(plotted: Sequence[Plotted], name: str) -> str:
    return next(one.recording.channels[name].unit for one in plotted if name in one.recording)


def _values(plotted: Sequence[Plotted], name: str) -> np.ndarray:
    """Return all values of a channel, recorded and simulated."""
    parts = [each[name] for one in plotted for each in (one.recording, one.simulation) if each is not None and name in each]
    values: np.ndarray = np.concatenate(parts)
    finite: np.ndarray = values[np.isfinite(values)]
    return finite


def _constant(plotted: Sequence[Plotted], name: str) -> float | None:
    """Return the one value that a channel has in all recordings and simulations, None where it has several."""
    values = _values(plotted, name)
    return float(values[0]) if values.size and (values == values[0]).all() else None


def _times(plotted: Sequence[Plotted]) -> tuple[list[np.ndarray], str]:
    """Return the times (N,) of each, aligned, or from its first row where they begin late or apart, and their label."""
    recordings = [one.recording for one in plotted]
    if any(one.shift_s is not None for one in plotted):
        return [one.recording.time + (one.shift_s or 0.0) for one in plotted], f"time of {plotted[0].path.stem} [s]"
    starts = [float(each.time[0]) if each.rows else 0.0 for each in recordings]
    if max(np.abs(starts)) < LATE_s and len(set(starts)) == 1:
        return [each.time for each in recordings], "time [s]"
    return [each.time - start for each, start in zip(recordings, starts, strict=True)], "time since the first row [s]"


def _title(plotted: Sequence[Plotted]) -> str:
    return plotted[0].path.name if len(plotted) == 1 else f"{plotted[0].path.name} and {len(plotted) - 1} more"


def _answer(plotted: Sequence[Plotted]) -> tuple[Verdict, str, str]:
    """Return the sentence on top, the command that comes next, and what it brings."""
    paths = [one.path for one in plotted]
    seconds = sum(float(one.recording.time[-1] - one.recording.time[0]) for one in plotted if one.recording.rows)
    count = "1 recording" if len(plotted) == 1 else f"{len(plotted)} recordings"
    said = f"{count}, {seconds:.4g} s in all, {len(plotted[0].recording.channels) - 1} channels."
    if plotted[0].simulation is None:
        next_command = command_line("plot", *paths, "--simulate", "-o", "simulated.html")
        return Verdict(said), next_command, "lays the simulation by the machine file over it."
    compared = [compare(one.recording, one.simulation) for one in plotted if one.simulation is not None]
    worst = max(compared, key=lambda each: max(channel.in_noise for channel in each.channels))
    if all(each.agrees for each in compared):
        return Verdict(f"{worst.verdict} {said}", "good"), "", ""
    command = command_line("diagnose", recorded_name(plotted[0].recording), *paths, "-o", "diagnosis")
    return Verdict(f"{worst.verdict} {said}", "bad"), command, "says what the simulation leaves out."
