"""The page of `isocenter identify`: how well the response is known, then the response itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.identification import FrequencyResponse
from hil.identification.report import response_lines
from hil.pages import Bullets, Page, Section, Text, Verdict
from hil.recording import Recording
from hil.reports.frf import frf_charts, own_elements
from hil.reports.made_from import command_line, files_fact, pose_words, recorded_machine, was_emulated

GOOD, POOR = 0.1, 1.0
"""Median standard deviation of the elements of an axis' own motor and encoder, as a share of their magnitude."""


def identified_page(
    responses: Sequence[FrequencyResponse], out: Sequence[Path], paths: Sequence[Path], recordings: Sequence[Recording]
) -> Page:
    """Return the page of responses, one for each pose, that were written to `out`."""
    sections = []
    for number, response in enumerate(responses):
        pose = _pose(response, recordings[0])
        at = f" at {pose}" if len(responses) > 1 and pose else ""
        folded = number > 0
        own = frf_charts(response, own_elements(response), pose=pose)
        sections.append(Section(f"From each motor to its own encoder{at}", [own], is_folded=folded))
        sections.append(Section(f"All elements{at}", [frf_charts(response, pose=pose)], is_folded=True))
        sections.append(Section(f"In words{at}", [Text(response.method), Bullets(response_lines(response))], is_folded=True))
    machine = recordings[0].metadata.get("machine", {}).get("name", "MACHINE")
    axis = (recordings[0].axes or ("AXIS",))[-1]
    return Page(
        f"Frequency response of {machine}",
        verdict(responses[0]),
        sections,
        command_line("shape", machine, "--axis", axis, "--frf", out[0], "-o", f"{axis}.shaper.npz"),
        "designs a reference shaper from it.",
        {"Machine": recorded_machine(recordings), "Files": files_fact(paths), "Written": files_fact(out), "Method": responses[0].method},
        was_emulated(recordings),
    )


def verdict(response: FrequencyResponse) -> Verdict:
    """Return how many lines there are and how well they are known."""
    frequencies = response.frequencies_Hz
    said = f"{len(frequencies)} lines from {frequencies[0]:.3g} to {frequencies[-1]:.4g} Hz; "
    if response.noise_covariance is None and response.total_covariance is None:
        return Verdict(said + "the recordings do not show how far they are off: record two periods or more.", "unsure")
    kind = "noise" if response.total_covariance is None else "total"
    deviation = response.standard_deviation(kind)  # type: ignore[arg-type]
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
