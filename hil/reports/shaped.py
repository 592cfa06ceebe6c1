"""The page of `isocenter shape`: the recommended shaper and what it does, then the others."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Mode
from hil.experiments.modest import middle_pose, modest_scan
from hil.machine import Machine
from hil.machine.load import name_to_load
from hil.pages import Bullets, Chart, Charts, Mark, Page, Scale, Section, Series, Table, Verdict
from hil.pages.contents import Kind
from hil.reports.made_from import command_line, machine_fact
from hil.shaping.in_time import InTime, settled
from hil.shaping.shaper_design import Candidates, Design
from hil.shaping.verdict import Subject

GOOD = 0.1
"""Vibration that is left at 10 percent off, as a share of that without a shaper."""

MOST = 5
"""Designs drawn: more curves than this cannot be told apart."""

SHOWN, LEAST_SHOWN_s = 1.3, 1.0
"""Of the time until the ringing is over, and at least, how much of a step is shown."""

NOTHING = 1e-6
"""Percent or milliseconds below which a number is the rounding of zero."""

LOWEST_Hz, POINTS = 0.05, 2000
FREQUENCY = Scale("frequency [Hz]", is_log=True)
GAINS = (1e-4, 10.0)
HEAD = ("design", "vibration [%]", "at ±10 % [%]", "transient [s]", "largest gain", "tracking error [%]", "ramp lag [ms]", "against it")


def shaped_page(
    machine: Machine,
    axis: str,
    sentence: str,
    candidates: Candidates,
    chosen: Design,
    subjects: Sequence[Subject],
    in_time: Mapping[str, InTime],
    out: Path,
    facts: Mapping[str, str],
) -> Page:
    """Return the page of designs.

    `chosen` was written to `out`, `sentence` is the answer, `in_time` are the loop's steps with it and with `none`; `facts` say under
    `From` what it was designed from.
    """
    rows = [_row(design) for design in candidates.designs]
    kinds: list[Kind] = ["good" if design is chosen else "unsure" if design.verdict.against else "plain" for design in candidates.designs]
    table = Table(HEAD, rows, frozenset(range(1, 7)), kinds)
    charts = response_charts(candidates, chosen, subjects, machine.sample_rate_Hz)
    refused = [f"{name}: {reason}" for name, reason in candidates.refused.items()]
    return Page(
        f"Reference shaper for {axis} of {machine.name}",
        Verdict(sentence, "unsure" if chosen.verdict.against or _left(chosen) > GOOD else "good"),
        [
            Section("A step of the reference, before and after", [step_charts(in_time, chosen.name)]),
            Section("What it passes, and what the axis makes of it", [charts]),
            Section("All designs", [table, *([Bullets(refused, "Not possible:")] if refused else [])]),
            Section("Poles left out", [Bullets(_left_out(chosen))], is_folded=True),
        ],
        command_line("run", "scan", "-m", name_to_load(machine), "-b", "BUS", *_scan(machine, axis), "--shaper", out, "-o", "scan.mf4"),
        "scans with it.",
        {"Machine": machine_fact(machine), **facts, "Written": out.name},
        facts["From"].startswith("EMULATED"),
    )


def _left(design: Design) -> float:
    """Return what a design leaves of the vibration: after the median move as simulated, where that is known."""
    residual = design.verdict.residual
    return design.verdict.vibration_at_10 if residual is None else residual.likely


def _scan(machine: Machine, axis: str) -> list[str]:
    """Return the options of a scan of the axis that asks little of the machine."""
    scales = {units.axis: math.pi / 180.0 if units.position == "rad" else 1e-3 for units in machine.units}
    scan = modest_scan(machine, axis, middle_pose(machine, 0.0))
    start, stop, speed = (f"{value / scales[axis]:.4g}" for value in (scan.start, scan.stop, scan.speed))
    pose = ",".join(f"{name}={position / scales[name]:.4g}" for name, position in scan.pose.items() if position)
    return ["--axis", axis, "--from", start, "--to", stop, "--speed", speed, *(["--pose", pose] if pose else [])]


def step_charts(in_time: Mapping[str, InTime], name: str) -> Charts:
    """Return the output that tracks and the ringing in it, without a shaper and with the one of this name."""
    labels = {"none": "without shaper", name: name}
    until = max(LEAST_SHOWN_s, SHOWN * max((at for at in settled(in_time["none"], in_time[name]) if np.isfinite(at)), default=0.0))
    output, ringing = [], []
    for look, (key, label) in enumerate(labels.items()):
        one = in_time[key]
        rows = one.time_s <= until
        output.append(Series(label, one.time_s[rows], one.output[rows], look=look))
        ringing.append(Series(label, one.time_s[rows], one.ringing[rows], look=look))
    time = Scale("time after the step [s]")
    cells = [
        Chart("Output after a step of 1", time, Scale("output"), output, group="step"),
        Chart("Ringing in it", time, Scale("ringing, share of the step"), ringing, group="step"),
    ]
    return Charts(cells, columns=2)


def response_charts(candidates: Candidates, chosen: Design, subjects: Sequence[Subject], sample_rate_Hz: float) -> Charts:
    """Return |G| of the shapers and |P G| of the shaped axis at the first pose, and the taps."""
    frequencies = np.geomspace(LOWEST_Hz, sample_rate_Hz / 4.0, POINTS)
    s = 2j * np.pi * frequencies
    plant = np.abs(subjects[0].dynamics.response(s))
    others = [design for design in candidates.designs if design is not chosen and design.name != "none"]
    drawn = ([chosen] if chosen.name != "none" else []) + others[: MOST - 1]
    passes, tracks = [], [Series("no shaper", frequencies, plant, look=0)]
    taps = []
    for look, design in enumerate(drawn, start=1):
        shaper: DelayFilter = design.filters[0]
        through = np.abs(shaper.response(s))
        passes.append(Series(design.name, frequencies, through, look=look))
        tracks.append(Series(design.name, frequencies, plant * through, look=look))
        taps.append(Series(design.name, np.asarray(shaper.delays_s), np.asarray(shaper.gains), is_points=True, look=look))
    marks = [mark for mark in map(_mark, subjects[0].ringing) if mark.x < frequencies[-1]]
    cells = [
        Chart("What the shaper passes", FREQUENCY, Scale("|G|", is_log=True, ends=GAINS), passes, marks=marks, group="frequency"),
        Chart(
            "What the shaped axis does", FREQUENCY, Scale("|H| = |P G|", is_log=True, ends=GAINS), tracks, marks=marks, group="frequency"
        ),
        Chart("Taps", Scale("delay [s]"), Scale("gain"), taps),
    ]
    return Charts(cells, columns=2)


def _mark(mode: Mode) -> Mark:
    frequency_Hz = mode.frequency_rad_s / (2.0 * np.pi)
    return Mark(frequency_Hz, f"{frequency_Hz:.3g} Hz, damping {mode.damping:.2g}")


def _row(design: Design) -> tuple[str, ...]:
    v = design.verdict
    numbers = [100.0 * v.vibration, 100.0 * v.vibration_at_10, v.transient_s, v.largest_gain, 100.0 * v.tracking, 1e3 * v.lag_s]
    return (v.name, *("0" if abs(number) < NOTHING else f"{number:.3g}" for number in numbers), v.against)


def _left_out(chosen: Design) -> list[str]:
    listed = chosen.verdict.left_out
    if not listed:
        return ["Every pole that matters is cancelled."]
    return [f"{each.frequency_Hz:.3g} Hz, damping {each.damping:.2g}: {each.residual:.2g} of a unit step is left" for each in listed]
