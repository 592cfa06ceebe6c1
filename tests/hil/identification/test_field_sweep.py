"""A sweep of the reference alone, as people record one, which lies beside the repository."""

from __future__ import annotations

import numpy as np
from places import DATA, needs_data

from hil.identification import identify_poses
from hil.machine import load_machine
from hil.recording import read_recording
from hil.simulation import in_effort

FIELD = DATA / "field"
pytestmark = needs_data("field", "inputs as people bring them are")


def test_the_plant_is_found_to_half_a_percent() -> None:
    """The plant is known: 9.5 Nm/A on 7.6 kg m^2 with 23 Nm s/rad, held for a sample and a sample late."""
    machine = load_machine(FIELD / "common" / "turntable.toml")
    recording = in_effort(read_recording(FIELD / "40-frf-reference-only" / "sweep.csv", machine), machine)
    (found,) = identify_poses([recording], "arbitrary_lrm", band_Hz=(0.5, 20.0))
    z = np.exp(2j * np.pi * found.frequencies_Hz / 200.0)
    a, period = 23.0 / 7.6, 1.0 / 200.0
    pole = np.exp(-a * period)
    truth = 9.5 / 7.6 / a * (period / (z - 1.0) - (1.0 - pole) / a / (z - pole)) / z
    place = list(found.output_names).index("position_turn")
    assert z.size == 391
    assert np.median(np.abs(found.G[:, place, 0] / truth - 1.0)) < 5e-3
