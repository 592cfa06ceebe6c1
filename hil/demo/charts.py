"""Charts of the demo."""

from __future__ import annotations

import numpy as np

from hil.demo.told import Story
from hil.pages import Chart, Charts, Scale, Series
from hil.reports.frf import frf_charts, own_elements
from hil.reports.identified import marks_of
from hil.reports.made_from import pose_of

RESIDUAL_PX = 130
SMOOTHED_s = 0.25
"""Over which the error of the simulations is averaged for its chart over the speed."""

NOMINAL, FRICTION = "machine file as it is", "with the friction"
SECONDS = Scale("time [s]")


def friction_charts(story: Story) -> Charts:
    """Return roll current recorded and simulated with what the simulations leave of it, and that again over the speed."""
    recording, name = story.recording, "current_roll"
    time, measured = recording.time, recording[name]
    left = {NOMINAL: measured - story.nominal[name], FRICTION: measured - story.with_friction[name]}
    over_time = (
        Chart(
            "Roll current, recorded and simulated",
            SECONDS,
            Scale("current_roll [A]"),
            [
                Series("recorded", time, measured),
                Series(f"simulated, {NOMINAL}", time, story.nominal[name], look=1),
                Series(f"simulated, {FRICTION}", time, story.with_friction[name], look=2),
            ],
            pose=pose_of(recording),
            group="time",
        ),
        Chart(
            "Recorded less simulated",
            SECONDS,
            Scale("residual [A]"),
            [Series(label, time, values, look=look) for look, (label, values) in enumerate(left.items(), start=1)],
            group="time",
            height=RESIDUAL_PX,
        ),
    )
    rate = story.machine.sample_rate_Hz
    speed = np.degrees(np.gradient(recording["reference_roll"]) * rate)
    rows = round(SMOOTHED_s * rate)
    over_speed = Chart(
        "What the simulations miss, over the speed",
        Scale("reference speed of roll [°/s]"),
        Scale(f"recorded less simulated, {SMOOTHED_s:g} s mean [A]"),
        [
            Series(label, speed[:: rows // 8 or 1], _smoothed(values, rows)[:: rows // 8 or 1], is_points=True, look=look)
            for look, (label, values) in enumerate(left.items(), start=1)
        ],
        note="A friction changes its sign with the speed: a step at standstill.",
        height=2 * RESIDUAL_PX,
    )
    return Charts([over_time, over_speed], columns=2)


def response_charts(story: Story, whole: bool) -> Charts:
    """Return the frequency response beside the machine file's plant: all elements, or those of an axis' own motor and encoder."""
    model = ("machine file, linearised", story.response.frequencies_Hz, story.linearisation)
    elements = None if whole else own_elements(story.response)
    return frf_charts(story.response, elements, compared=[model], marks=marks_of(story.resonances), pose=pose_of(story.recording))


def experiment_charts(story: Story) -> Charts:
    """Return reference and position, excitation and current of every axis over the last period."""
    recording = story.recording
    last = slice(recording.rows - recording.experiment["period_samples"], recording.rows)
    time = recording.time[last] - recording.time[last][0]
    label = Scale("time in the period [s]")
    cells = []
    for axis in story.machine.axes:
        angle = [
            Series("position", time, np.degrees(recording[f"position_{axis}"][last]), look=2),
            Series("reference", time, np.degrees(recording[f"reference_{axis}"][last]), look=7),
        ]
        current = [
            Series("current", time, recording[f"current_{axis}"][last], look=2),
            Series("excitation", time, recording[f"excitation_{axis}"][last], look=5),
        ]
        cells.append(
            (
                Chart(f"{axis}: angle", label, Scale("angle [°]"), angle, pose=pose_of(recording), group="period"),
                Chart(f"{axis}: motor", label, Scale("motor current [A]"), current, group="period"),
            )
        )
    return Charts(cells, columns=2)


def _smoothed(values: np.ndarray, rows: int) -> np.ndarray:
    return np.convolve(values, np.full(rows, 1.0 / rows), mode="same")
