"""What an encoder's readings show by themselves is named, and taken into account."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.diagnose import diagnose
from hil.recording import Recording

TRUTH = {"duration_s": 4.0, "seed": 5}


def changed(recordings: dict[str, Recording], by: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> dict[str, Recording]:
    """Recordings with other readings of the carriage's encoder."""
    found = {}
    for number, (name, one) in enumerate(recordings.items()):
        channel = one.channels["position_carriage"]
        values = by(channel.values, np.random.default_rng(number))
        found[name] = replace(one, channels={**one.channels, "position_carriage": replace(channel, values=values)})
    return found


@pytest.mark.nightly
def test_a_lattice_coarser_than_the_files_is_named_with_its_step() -> None:
    step = 17.0 * MACHINE.plant.encoders[0].resolution

    def coarse(x: np.ndarray, _: np.random.Generator) -> np.ndarray:
        return step * np.floor(x / step + 0.5)

    found = diagnose(MACHINE, changed(repeats(**TRUTH), coarse), changed(repeats(1, experiment=1, **TRUTH), coarse)).diagnosis
    assert [str(finding.effect) for finding in found.findings] == ["encoder_quantization at position_carriage"]
    assert found.verdict == "explained"
    assert found.findings[0].parameters["q"].value == pytest.approx(step, rel=1e-3)
    assert found.fit.held_out is not None
    assert found.fit.held_out.extended == pytest.approx(1.0, abs=0.25)


def test_readings_that_were_lost_are_named_with_their_share_and_explain_no_physics() -> None:
    def lost(x: np.ndarray, random: np.random.Generator) -> np.ndarray:
        gone = random.random(len(x)) < 0.1
        gone[0] = False
        return x[np.maximum.accumulate(np.where(gone, 0, np.arange(len(x))))]

    found = diagnose(MACHINE, changed(repeats(**TRUTH), lost), changed(repeats(1, experiment=1, **TRUTH), lost)).diagnosis
    assert [str(finding.effect) for finding in found.findings] == ["sample_dropout at position_carriage"]
    low, high = found.findings[0].parameters["p"].ci95
    assert 0.07 < low < high < 0.16
