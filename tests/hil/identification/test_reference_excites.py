"""Where nothing is added to the command, a moving reference is what excites the loop."""

from __future__ import annotations

import numpy as np
import pytest

from hil.errors import RecordingError
from hil.identification import IdentificationError, identify_poses
from hil.recording import Channel, Recording

RATE_Hz = 200.0
POLE, GAIN = 0.9, 0.05
"""Of the plant y[k+1] = POLE y[k] + GAIN u[k], under the controller u = FEEDBACK (r - y)."""
FEEDBACK = 3.0


def closed_loop(reference: np.ndarray, excitation: np.ndarray | None = None, noise: float = 0.0) -> Recording:
    """The loop of a first-order plant with noise in its output, as the channels of axis `turn`."""
    added = np.zeros_like(reference) if excitation is None else excitation
    rng = np.random.default_rng(4)
    y, measured, command = 0.0, np.zeros_like(reference), np.zeros_like(reference)
    for k in range(len(reference)):
        measured[k] = y + noise * rng.standard_normal()
        command[k] = FEEDBACK * (reference[k] - measured[k]) + added[k]
        y = POLE * y + GAIN * command[k]
    channels = {
        "time": Channel("s", np.arange(len(reference)) / RATE_Hz),
        "reference_turn": Channel("rad", reference),
        "command_turn": Channel("A", command),
        "position_turn": Channel("rad", measured),
    }
    if excitation is not None:
        channels["excitation_turn"] = Channel("A", excitation)
    return Recording(channels, {"machine": {"axes": ["turn"]}})


def sweep(rows: int = 4000) -> np.ndarray:
    time_s = np.arange(rows) / RATE_Hz
    return 0.05 * np.sin(2.0 * np.pi * (0.5 * time_s + 0.5 * 19.5 / time_s[-1] * time_s**2))


def truth(frequencies_Hz: np.ndarray) -> np.ndarray:
    response: np.ndarray = GAIN / (np.exp(2j * np.pi * frequencies_Hz / RATE_Hz) - POLE)
    return response


def test_a_sweep_of_the_reference_gives_the_plant_not_the_controller() -> None:
    """With noise in the loop, the plant's response from command to position; without the instrument it would lean to -1 / controller."""
    (found,) = identify_poses([closed_loop(sweep(), noise=2e-3)], "arbitrary_lrm", band_Hz=(1.0, 15.0))
    np.testing.assert_allclose(np.median(np.abs(found.G[:, 0, 0] / truth(found.frequencies_Hz) - 1.0)), 0.0, atol=0.03)
    assert "nothing is added to the command: reference_turn taken as what excites the loop" in found.notes


def test_an_excitation_goes_before_a_reference_that_moves() -> None:
    (found,) = identify_poses([closed_loop(0.1 * sweep(), excitation=sweep())], "arbitrary_lrm", band_Hz=(1.0, 15.0))
    assert found.notes == ("the reference moves: what it does to the outputs counts as noise",)


def test_where_nothing_moves_the_way_to_name_the_excitation_is_told() -> None:
    with pytest.raises(IdentificationError, match=r"convert --map NAME=excitation_<axis>`, of reference_turn, command_turn, position_turn"):
        identify_poses([closed_loop(np.full(400, 0.1))], "arbitrary_lrm", band_Hz=(1.0, 15.0))


def test_rows_at_the_ends_that_lack_a_channel_are_left_out_and_said() -> None:
    whole = closed_loop(sweep())
    cut = dict(whole.channels)
    for name in ("reference_turn", "command_turn", "position_turn"):
        cut[name] = Channel(cut[name].unit, np.where(np.arange(whole.rows) < 3, np.nan, cut[name].values))
    (found,) = identify_poses([Recording(cut, whole.metadata)], "arbitrary_lrm", band_Hz=(1.0, 15.0))
    assert "3 rows at the ends of the recordings, in which a channel is missing, are left out" in found.notes
    np.testing.assert_allclose(np.median(np.abs(found.G[:, 0, 0] / truth(found.frequencies_Hz) - 1.0)), 0.0, atol=0.03)


def test_an_axis_that_is_asked_for_is_excited_by_its_own_reference() -> None:
    one, other = closed_loop(sweep()), closed_loop(sweep()[::-1], excitation=sweep()[::-1])
    channels = dict(one.channels) | {name.replace("turn", "tilt"): channel for name, channel in other.channels.items() if name != "time"}
    both = Recording(channels, {"machine": {"axes": ["turn", "tilt"]}})
    (found,) = identify_poses([both], "arbitrary_lrm", axes=["turn"], outputs=["position_turn"], band_Hz=(1.0, 15.0))
    assert "nothing is added to the command: reference_turn taken as what excites the loop" in found.notes
    np.testing.assert_allclose(np.median(np.abs(found.G[:, 0, 0] / truth(found.frequencies_Hz) - 1.0)), 0.0, atol=0.03)


def test_what_is_missing_is_refused_with_the_option() -> None:
    whole = closed_loop(sweep())
    with pytest.raises(RecordingError, match=r"not periodic: .*`--method arbitrary_lrm --band LOW:HIGH` takes any excitation"):
        identify_poses([whole], "robust_bla")
    measured = {name.replace("command", "current"): channel for name, channel in whole.channels.items()}
    with pytest.raises(IdentificationError, match=r"no channel command_turn, .*`--input measured` takes current_turn"):
        identify_poses([Recording(measured, whole.metadata)], "arbitrary_lrm", band_Hz=(1.0, 15.0))
