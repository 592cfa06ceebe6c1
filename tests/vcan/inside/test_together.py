"""Multisine with jog and the observer together on vcan0, and a shaped scan, emulator and loop in two processes, as at a bench."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from at_rest import SHIPPED
from processes import Done
from runs import DESIGN, SHAPER, run_to_its_end

from hil.machine import load_machine
from hil.observing import observe, read_design
from hil.recording import Recording, read_recording

pytestmark = [pytest.mark.vcan, pytest.mark.nightly]  # observer and shaper know no bus, and are shown in lockstep for every change


def assert_observed(recording: Recording, design: Path, rate_Hz: int) -> None:
    """Estimates in every row, those of a replay to the bit, and about where the link encoders are."""
    replayed = observe(recording, read_design(design).observer())
    assert np.array_equal(recording.matrix(replayed.names), replayed.values, equal_nan=True)
    assert np.isfinite(replayed.values[1:, : replayed.names.index("estimate_nis_window")]).all()
    for axis in ("propeller", "roll"):
        off = recording[f"link_position_{axis}"] - recording[f"estimate_link_position_{axis}"]
        assert np.nanmax(np.abs(off[rate_Hz:])) < 1e-4
    assert (recording["estimate_measured"] == 10).mean() > 0.9


@pytest.fixture
def at_30_degrees(interface: str, prepared: Path, emulate: Callable[..., dict[str, str]]) -> tuple[str, ...]:
    """Options of `run` at a machine that stands at roll 30 degrees, with the observer."""
    bus = f"socketcan:{interface}"
    emulate(SHIPPED, "--bus", bus, "--pose", "roll=30")
    observer = ("--observer", str(prepared / DESIGN))
    return ("--machine", SHIPPED, "--bus", bus, "--pose", "roll=30", *observer)


def test_a_multisine_with_jog_runs_with_the_observer(
    prepared: Path, at_30_degrees: tuple[str, ...], run: Callable[..., Done], tmp_path: Path
) -> None:
    rate_Hz = round(load_machine(SHIPPED).sample_rate_Hz)
    experiment = ("--experiments", "single", "--axes", "roll", "--amplitude", "0.5", "--period", "1", "--jog", "0.05", "--periods", "1")
    recording = read_recording(run_to_its_end(lambda *out: run("multisine", *at_30_degrees, *experiment, *out), tmp_path))
    assert_observed(recording, prepared / DESIGN, rate_Hz)
    ticks = recording["time"] * rate_Hz  # those that a loaded computer skipped are no rows
    assert ticks == pytest.approx(np.round(ticks), abs=1e-6)
    assert (np.diff(ticks) > 0.5).all()
    assert recording.rows > rate_Hz
    assert ticks[-1] < 2 * rate_Hz
    for channel in ("position_roll", "imu_z"):
        assert np.isfinite(recording[channel]).mean() > 0.9, f"{channel} did not arrive"
    assert np.nanmax(np.abs(recording["reference_roll"] - recording["position_roll"])) < np.radians(1.0)


def test_a_shaped_scan_runs_with_the_observer(
    prepared: Path, at_30_degrees: tuple[str, ...], run: Callable[..., Done], tmp_path: Path
) -> None:
    sweep = ("--axis", "roll", "--from", "30", "--to", "34", "--speed", "4", "--dwell", "0.5", "--shaper", str(prepared / SHAPER))
    recording = read_recording(run_to_its_end(lambda *out: run("scan", *at_30_degrees, *sweep, *out), tmp_path))
    assert_observed(recording, prepared / DESIGN, round(load_machine(SHIPPED).sample_rate_Hz))
    assert np.abs(recording["reference_roll"] - recording["reference_raw_roll"]).max() > 1e-4  # the shaper had its say
    assert np.nanmax(np.abs(recording["reference_roll"] - recording["position_roll"])) < np.radians(1.0)
