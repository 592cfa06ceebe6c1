"""The page of `isocenter identify`: the resonances, and how well the response is known, then the response itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.identification import FrequencyResponse
from hil.identification.modal.resonances import Resonances
from hil.identification.report import response_lines
from hil.pages import Bullets, Mark, Page, Section, Table, Text, Verdict
from hil.pages.contents import Block
from hil.recording import Recording
from hil.reports.frf import frf_charts, own_elements
from hil.reports.made_from import command_line, files_fact, pose_words, recorded_machine, recorded_name, was_emulated

GOOD, POOR = 0.1, 1.0
"""Median standard deviation of the elements of an axis' own motor and encoder, as a share of their magnitude."""


def identified_page(
    responses: Sequence[FrequencyResponse],
    modes: Sequence[Resonances],
    out: Sequence[Path],
    paths: Sequence[Path],
    recordings: Sequence[Recording],
) -> Page:
    """Return the page of responses with their resonances, one for each pose, that were written to `out`."""
    sections = []
    for number, (response, resonances) in enumerate(zip(responses, modes, strict=True)):
        pose = _pose(response, recordings[0])
        at = f" at {pose}" if len(responses) > 1 and pose else ""
        marks = marks_of(resonances)
        own = frf_charts(response, own_elements(response), marks=marks, pose=pose)
        sections.append(Section(f"From each motor to its own encoder{at}", [own, _resonances(resonances)], is_folded=number > 0))
        sections.append(Section(f"All elements{at}", [frf_charts(response, marks=marks, pose=pose)], is_folded=True))
        sections.append(Section(f"In words{at}", [Bullets(response_lines(response, resonances))], is_folded=True))
    machine = recordings[0].metadata.get("machine", {}).get("name", "MACHINE")
    axis = (recordings[0].axes or ("AXIS",))[-1]
    return Page(
        f"Frequency response of {machine}",
        verdict(responses[0], modes[0]),
        sections,
        command_line("shape", recorded_name(recordings[0]), "--axis", axis, "--frf", out[0], "-o", f"{axis}.shaper.npz"),
        "designs a reference shaper from it.",
        {"Machine": recorded_machine(recordings), "Files": files_fact(paths), "Written": files_fact(out), "Method": responses[0].method},
        was_emulated(recordings),
    )


def marks_of(resonances: Resonances) -> list[Mark]:
    """Return the resonances as marks of a chart over frequency."""
    return [Mark(each.frequency_Hz, f"{each.frequency_Hz:.4g} Hz, damping {100.0 * each.damping:.2g} %") for each in resonances.found]


def _resonances(resonances: Resonances) -> Block:
    if not resonances.found:
        return Text(f"No resonance is marked: {resonances.reason}.")
    rows = []
    for number, each in enumerate(resonances.found, start=1):
        spans = [f"{low:.5g} to {high:.5g}" for low, high in (each.frequency_ci95_Hz, tuple(100.0 * end for end in each.damping_ci95))]
        values = (str(number), f"{each.frequency_Hz:.4g}", spans[0], f"{100.0 * each.damping:.3g}", spans[1])
        rows.append((*values, f"{each.input} → {each.output}"))
    head = ("resonance", "frequency [Hz]", "95 % bounds", "damping [%]", "95 % bounds", "clearest in")
    return Table(head, rows, frozenset((1, 2, 3, 4)))


def verdict(response: FrequencyResponse, resonances: Resonances) -> Verdict:
    """Return the resonances, and how well the response is known."""
    frequencies = response.frequencies_Hz
    found = [mark.label for mark in marks_of(resonances)]
    said = f"Resonances at {'; '.join(found)}. " if found else f"No resonance: {resonances.reason}. "
    said += f"{len(frequencies)} lines from {frequencies[0]:.3g} to {frequencies[-1]:.4g} Hz; "
    if response.noise_covariance is None and response.total_covariance is None:
        return Verdict(said + "the recordings do not show how far they are off: record two periods or more.", "unsure")
    deviation = response.standard_deviation("noise" if response.total_covariance is None else "total")
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = [float(np.nanmedian(deviation[:, i, j] / np.abs(response.G[:, i, j]))) for i, j in own_elements(response)]
    worst = max(shares)
    known = f"from each motor to its own encoder known to {worst:.2g} of the magnitude (median standard deviation) or better."
    return Verdict(said + known, "good" if worst < GOOD else "unsure" if worst < POOR else "bad")


def _pose(response: FrequencyResponse, recording: Recording) -> str:
    if len(response.pose) != len(recording.axes):
        return ""
    units = {axis: recording.channels[name].unit for axis in recording.axes if (name := f"position_{axis}") in recording}
    return pose_words({axis: (value, units.get(axis, "rad")) for axis, value in zip(recording.axes, response.pose, strict=True)})
