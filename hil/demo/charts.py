"""Charts of the demo."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path

import numpy as np

from hil.demo.told import Story
from hil.errors import BadAnswerError
from hil.machine import load_machine
from hil.pages import Chart, Charts, Scale, Series
from hil.reports.made_from import pose_of
from hil.simulation import simulate

RECORDED_PX = 180
NOMINAL, ANSWER = "machine file as it is", "the tool's answer"


def held_out_charts(story: Story, folder: Path) -> Charts:
    """Return the held-out channel that the answer helps most: what simulations leave of it, and how it was recorded.

    The second simulation is of the machine file that the diagnosis left in the folder, with the effects it named. One that does not run is
    left out. The zero of an encoder is not known: its residual is about its mean, as in the table of errors.
    """
    held, channel = story.held_out, _telling(story)
    unit, scaled = held.channels[channel].unit, 1.0
    if unit.startswith("rad"):
        unit, scaled = unit.replace("rad", "deg"), math.degrees(1.0)
    measured = scaled * held[channel]
    simulated = {}
    retuned = load_machine(folder / "diagnosis" / "machine.toml")
    for label, machine, effects in ((NOMINAL, story.machine, ()), (ANSWER, retuned, story.answered.effects)):
        with suppress(BadAnswerError):
            values = simulate(machine, held, effects)[channel]
            is_encoder = channel in {encoder.channel for encoder in machine.plant.encoders}
            simulated[label] = scaled * (values + np.nanmean(held[channel] - values) if is_encoder else values)
    seconds, pose = Scale("time [s]"), pose_of(held)
    left = [Series(label, held.time, measured - values, look=look) for look, (label, values) in enumerate(simulated.items(), start=1)]
    whole = [
        Series("recorded", held.time, measured, look=0),
        *(Series(f"simulated, {label}", held.time, values, look=look) for look, (label, values) in enumerate(simulated.items(), start=1)),
    ]
    said = channel.replace("_", " ")
    charts = (
        Chart(
            f"{said}, recorded and simulated", seconds, Scale(f"{said} [{unit}]"), whole, pose=pose, group="held out", height=RECORDED_PX
        ),
        Chart(f"{said}, recorded less simulated", seconds, Scale(f"error [{unit}]"), left, pose=pose, group="held out"),
    )
    return Charts([charts], columns=1)


def _telling(story: Story) -> str:
    """Return the channel whose error in units of noise falls most by the answer."""
    channels = story.answered.diagnosis.fit.channels
    fallen = {
        name: (stages.nominal - stages.extended) / stages.noise_floor
        for name, stages in channels.items()
        if stages.nominal is not None and stages.extended is not None and stages.noise_floor
    }
    return max(fallen, key=lambda name: fallen[name], default=next(iter(channels)))
