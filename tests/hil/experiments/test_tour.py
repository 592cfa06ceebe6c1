"""A tour stands still at every stop, keeps to its share of the machine's pace, and its file reads back equal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.errors import ExperimentError
from hil.experiments import Tour, experiment_from_text, read_experiment, write_experiment
from hil.machine import load_machine

CARM = load_machine("carm")
STOPS = ({"roll": -1.0}, {"roll": 1.0}, {"propeller": 0.5}, {"roll": -0.3, "propeller": 0.0})


def test_it_goes_to_every_stop_and_stands_there() -> None:
    plan = Tour(STOPS, pace=0.5, dwell_s=0.5).plans(CARM)[0]
    still = np.flatnonzero((np.abs(np.diff(plan.reference, axis=0)) < 1e-12).all(axis=1))
    stood = [run for run in np.split(still, np.flatnonzero(np.diff(still) > 1) + 1) if len(run) >= 127]
    places = [plan.reference[run[0] + 1] for run in stood]
    np.testing.assert_allclose(places, [[0.0, -1.0], [0.0, 1.0], [0.5, 1.0], [0.0, -0.3]], atol=1e-9)
    speed = np.abs(np.diff(plan.reference, axis=0)).max(axis=0) * 256.0
    limits = 0.5 * np.array([limit.speed for limit in CARM.limits])
    assert (speed <= limits * (1.0 + 1e-9)).all()
    assert speed[1] > 0.95 * limits[1]


def test_its_file_reads_back_equal(tmp_path: Path) -> None:
    tour = Tour(STOPS, pace=0.3, dwell_s=2.0)
    write_experiment(tour, CARM, tmp_path / "tour.toml")
    assert read_experiment(tmp_path / "tour.toml", CARM) == tour


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "stops: is missing"),
        ("stops = 3", "stops = 3: must be a list"),
        ("stops = [{roll_deg = 3}]", "1 stops: must be two at least"),
        ("stops = [{rol_deg = 3}, {roll_deg = 2}]", "stops[0].rol_deg = 3: unknown key; did you mean"),
        ("stops = [{roll_deg = 3}, {roll_deg = 200}]", "roll = 200 deg is outside"),
        ("dwell_s = 0\nstops = [{roll_deg = 3}, {roll_deg = 3}]", "dwell_s = 0 and one pose throughout"),
        ("stops = [{roll_deg = 3}, 4]", "stops[1] = 4: must be a table; write [name] or { key = value }"),
        (
            "dwell_s = 40000.0\nstops = [{roll_deg = 3}, {roll_deg = 4}, {roll_deg = 3}]",
            "takes 1.2e+05 s at least with pace = 0.2, dwell_s = 40000",
        ),
        ("pace = 1e-7\nstops = [{roll_deg = 3}, {roll_deg = 90}]", "with pace = 1e-07, dwell_s = 1: a day at most"),
        ("pace = 2.0\nstops = [{roll_deg = 3}, {roll_deg = 20}]", "pace = 2.0: must be at most 1"),
    ],
)
def test_a_file_that_cannot_be_run_is_one_line(text: str, line: str) -> None:
    with pytest.raises(ExperimentError) as refused:
        experiment_from_text(f'format = 1\nkind = "tour"\n{text}\n', CARM).plans(CARM)
    assert line in str(refused.value)
    assert "\n" not in str(refused.value)
