"""The page of `isocenter calibrate spot`: how far the focal spot moves, then its track and spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.calibration.marker.focal_spot import SpotTrack
from hil.machine import Machine
from hil.machine.load import name_to_load
from hil.pages import Band, Bullets, Chart, Charts, Mark, Page, Scale, Section, Series, Verdict
from hil.reports.made_from import command_line, machine_fact

WAYS = ("along columns", "along rows")


def spot_page(machine: Machine, track: SpotTrack, anode_Hz: float | None, scan: Path, said: Sequence[str]) -> Page:
    """Return the page of a focal spot's track; `said` is what the command said."""
    reach = 1e6 * np.ptp(track.spot_m, axis=0)
    sigma = 1e6 * float(np.median(track.sigma_m))
    moves = f"The focal spot moves by {reach[0]:.1f} µm along columns and {reach[1]:.1f} µm along rows"
    return Page(
        f"Focal spot in {scan.name}",
        Verdict(f"{moves}, known to {sigma:.2f} µm in an exposure."),
        [
            Section("Displacement, and its spectrum", [spot_charts(track, anode_Hz)]),
            Section("What the command said", [Bullets(said)], is_folded=True),
        ],
        command_line("calibrate", "marker", name_to_load(machine), "SCAN", "-o", "marker.npz"),
        "shows where tube and panel stand to each other in a scan.",
        {"Machine": machine_fact(machine), "From": scan.name},
    )


def spot_charts(track: SpotTrack, anode_Hz: float | None) -> Charts:
    """Return displacement over time with two standard deviations, and amplitudes over frequency with the anode's alias marked."""
    frequencies, amplitudes = track.spectrum()
    half = np.full(len(track.time_s), 2e6 * float(np.median(track.sigma_m)))
    band = Band("two standard deviations of one exposure", track.time_s, -half, half)
    places = [Series(way, track.time_s, 1e6 * track.spot_m[:, k], look=k) for k, way in enumerate(WAYS)]
    lines = [Series(way, frequencies, 1e6 * amplitudes[:, k], look=k) for k, way in enumerate(WAYS)]
    marks = []
    if anode_Hz is not None:
        alias, wobble = track.line(anode_Hz)
        size = " and ".join(f"{1e6 * each:.1f}" for each in wobble)
        marks = [Mark(alias, f"{alias:.2f} Hz, the anode's {anode_Hz:g} Hz among the frames: {size} µm")]
    return Charts(
        [
            Chart("Displacement of the focal spot", Scale("time [s]"), Scale("displacement [µm]"), places, [band]),
            Chart("Its spectrum", Scale("frequency among the frames [Hz]"), Scale("amplitude [µm]"), lines, marks=marks),
        ],
        columns=2,
    )
