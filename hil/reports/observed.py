"""The page of `isocenter observe`: whether the estimates can be trusted, then where the detector was."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from hil.machine import Machine
from hil.machine.load import name_to_load
from hil.observing import Estimate
from hil.pages import Band, Bullets, Chart, Charts, Page, Scale, Section, Series, Verdict
from hil.recording import Recording
from hil.reports.made_from import command_line, machine_fact, pose_of, was_emulated

BAND = 0.95
FEW, MANY = 0.01, 0.10
"""Shares of rows with an alarm: fewer are chance, more say that the machine is not that of the model."""

LEAST_NIS = 1e-3
SECONDS = Scale("time [s]")


def observed_page(
    machine: Machine, estimate: Estimate, recording: Recording, files: tuple[Path, Path], design: Path | None, said: Sequence[str]
) -> Page:
    """Return the page of estimates over a recording.

    `files` are recording and estimates, `design` is the file that has the observer, if one has, `said` what the command said.
    """
    source, out = files
    pose = pose_of(recording)
    sections = [
        Section("Where the detector was", [detector_charts(estimate, pose)]),
        Section("Whether model and readings agree", [consistency_charts(estimate)]),
        Section("What the command said", [Bullets(said)], is_folded=True),
    ]
    return Page(
        f"Observer over {source.name}",
        verdict(estimate),
        sections,
        command_line("calibrate", "data", name_to_load(machine), *_observed(source, out, design), "-o", "scan.geometry.npz"),
        "turns it into the geometry of a scan, with a few images of the phantom.",
        {"Machine": machine_fact(machine), "Recording": source.name, "Written": out.name, "Filter": estimate.filter},
        was_emulated([recording]),
    )


def _observed(source: Path, out: Path, design: Path | None) -> list[object]:
    """Return what tells `calibrate data` of the observer: its design, or a recording that has its estimates."""
    if design is None and out.suffix != ".npz":
        return [out, "SCAN"]
    return [source, "SCAN", "--design", design or "DESIGN.npz"]  # as --save-design would have written it


def verdict(estimate: Estimate) -> Verdict:
    """Return whether the estimates are as good as they state."""
    mean, alarm = estimate.mean_nis, estimate.alarm_share
    shift = max(float(np.sqrt(np.mean(estimate[f"estimate_detector_{axis}"] ** 2))) for axis in "xyz")
    said = f"The detector was off by up to {1e3 * shift:.3g} mm rms along an axis; "
    if alarm <= FEW:
        return Verdict(said + f"the sensors bear out its accuracy (squared innovations {mean:.2f} of what is expected).", "good")
    said += f"in {alarm:.1%} of the rows an alarm says that the sensors contradict the model: it may be worse than stated there "
    return Verdict(said + f"(squared innovations {mean:.2f} of what is expected).", "unsure" if alarm <= MANY else "bad")


def detector_charts(estimate: Estimate, pose: str) -> Charts:
    """Return shift and turn of the detector with two standard deviations, a chart each."""
    cells = []
    for prefix, what, unit in (("estimate_detector_", "shift", "mm"), ("estimate_detector_r", "turn", "mrad")):
        for name in "xyz":
            value = 1e3 * estimate[prefix + name]
            half = 2e3 * np.sqrt(estimate[f"{prefix}{name}_variance"])
            band = Band("two standard deviations", estimate.time_s, value - half, value + half)
            title = f"Detector's {what} {'along' if what == 'shift' else 'about'} its {name}"
            series = [Series("estimate", estimate.time_s, value, look=2)]
            cells.append(Chart(title, SECONDS, Scale(f"{what} [{unit}]"), series, [band], pose=pose, group="time", height=170))
    return Charts(cells, columns=3)


def consistency_charts(estimate: Estimate) -> Charts:
    """Return the squared innovations per measurement with their 95 % band, and where there is an alarm."""
    time, measured = estimate.time_s, np.maximum(estimate["estimate_measured"], 1.0)
    nis = np.maximum(estimate["estimate_nis"] / measured, LEAST_NIS)
    low, high = (stats.chi2.ppf(tail, measured) / measured for tail in ((1.0 - BAND) / 2.0, (1.0 + BAND) / 2.0))
    alarm = estimate["estimate_alarm"] > 0.0
    window = estimate["estimate_nis_window"]
    series = [
        Series("each row", time, nis, is_points=True, look=6),
        Series("window", time, np.where(window > 0.0, window, np.nan), look=0),
        Series("window with an alarm", time, np.where(alarm & (window > 0.0), window, np.nan), look=1),
    ]
    band = Band(f"{BAND:.0%} of rows", time, np.maximum(low, LEAST_NIS), high)
    title, scale = "Squared innovations per measurement", Scale("NIS per measurement", is_log=True)
    return Charts([Chart(title, SECONDS, scale, series, [band], note="1 is what noise alone makes.", group="time")])
