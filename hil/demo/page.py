"""The demo's page: what was hidden and how it shows, first of all."""

from __future__ import annotations

import shlex
from pathlib import Path

from hil.demo.charts import experiment_charts, friction_charts, response_charts
from hil.demo.told import Story
from hil.pages import Page, Section, Table, Text, Verdict, write_page
from hil.reports.made_from import files_fact, machine_fact
from hil.simulation import ChannelComparison

INTRODUCTION = (
    "The emulated machine had a Coulomb friction on its roll axis that its file does not know. Both simulations get the recording's"
    " reference and excitation and nothing else. The loop hides the friction from the encoder: look at the current first."
)
RESPONSE = (
    "Best linear approximation at {lines} lines from {low:.2f} to {high:.1f} Hz, averaged over realisations and periods. Where the"
    " nonlinear distortion stands above the noise, the machine is not linear: it rubs. Below about 1 Hz the friction is larger than what"
    " the multisine moves there, so the estimate of the roll column says little."
)
EXPERIMENT = (
    "A random-phase multisine on both motors while both axes jog by 2° at 0.05 Hz, so that stick-slip friction does not hold them. Last"
    " period of the first recording."
)


def write_demo_page(story: Story, folder: Path) -> Path:
    """Write `index.html` into a folder and return its path."""
    return write_page(page_of(story, folder), folder / "index.html")


def page_of(story: Story, folder: Path) -> Page:
    """Return the page of a demo that was run into a folder."""
    before, after = (comparison["current_roll"].nrmse for comparison in (story.nominal_comparison, story.friction_comparison))
    hidden = ", ".join(f"{name} = {value:g} Nm" for name, value in story.effect.parameters.items())
    frequencies = story.response.frequencies_Hz
    response = RESPONSE.format(lines=len(frequencies), low=frequencies[0], high=frequencies[-1])
    rows = [_row(*pair) for pair in zip(story.nominal_comparison.channels, story.friction_comparison.channels, strict=True)]
    table = Table(("channel", "rms without", "NRMSE", "rms with it", "NRMSE"), rows, frozenset((1, 2, 3, 4)))
    return Page(
        "Demo: an emulated C-arm held against its simulation",
        Verdict(
            f"The simulation misses the roll current by {before:.1%}; with the friction hidden from it ({hidden}) by {after:.1%}.",
            "good" if after < before else "bad",
        ),
        [
            Section("What the machine file does not say", [Text(INTRODUCTION), friction_charts(story)]),
            Section("Every channel, without and with the friction", [table], is_folded=True),
            Section("The frequency response", [Text(response), response_charts(story, whole=False)]),
            Section("All elements of the frequency response", [response_charts(story, whole=True)], is_folded=True),
            Section("The experiment", [Text(EXPERIMENT), experiment_charts(story)], is_folded=True),
        ],
        next_command=f"isocenter diagnose {story.machine.name} {shlex.quote(str(folder))}/carm_r*.mf4 -o diagnosis",
        next_reason="names what is missing from the recordings alone.",
        facts={
            "Machine": machine_fact(story.machine),
            "Files": files_fact(story.paths),
            "Recorded": f"{story.recorded_s:.0f} s at {story.machine.sample_rate_Hz:g} Hz, every CAN frame, serial byte and Modbus message"
            f" encoded and decoded, at {story.lockstep_factor:.0f} times real time",
        },
        is_emulated=True,
    )


def _row(nominal: ChannelComparison, friction: ChannelComparison) -> list[str]:
    return [nominal.name, *(text for each in (nominal, friction) for text in (f"{each.rms:.3g} {each.unit}", each.nrmse_text))]
