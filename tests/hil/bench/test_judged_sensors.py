"""Sensors that fail in a run over `lockstep:` are said at its end, marked in its rows and kept in its metadata; sound ones are not."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM

from drivers.interface import Sample
from hil.bench.bench import Bench
from hil.bench.loop import Sink
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.bench.signals import Signals
from hil.bench.timing import LoopTiming
from hil.errors import LoopAbortedError
from hil.experiments import Move, Multisine, Scan, Static
from hil.experiments.jog import Jog
from hil.machine import Machine, load_machine
from hil.recording import Recording, read_recording

ROLL = CARM.axis_index("roll")
COUNT_rad = CARM.bus.scalings[ROLL].position_resolution
SENSORS = ["imu", "encoders_propeller", "encoders_roll", "temperature_propeller", "temperature_roll", "drive_propeller", "drive_roll"]

Spoil = Callable[[Sample, int], None]


class SpoilingLink:
    """Spoils the samples of recorded rows on their way from the machine to the loop."""

    def __init__(self, bench: Bench, spoil: Spoil) -> None:
        self._link, self._spoil = bench.loop.link, spoil
        self._run = bench.loop.run
        self._row = -1  # of the recorded run; -1 outside it
        bench.loop.link = self
        bench.loop.run = self.run  # type: ignore[method-assign]

    def run(self, plan: Signals, sink: Sink | None = None, progress: Callable[[int], None] | None = None) -> LoopTiming:
        self._row = 0 if sink is not None else -1
        return self._run(plan, sink, progress)

    def exchange(self, command: np.ndarray) -> Sample:
        sample = self._link.exchange(command)
        if self._row >= 0:
            self._spoil(sample, self._row)
            self._row += 1
        return sample

    def stop(self) -> None:
        self._link.stop()

    @property
    def outcome(self) -> str:
        return self._link.outcome


def run_spoiled(path: Path, spoil: Spoil, seconds: float = 3.0) -> tuple[LoopTiming, Recording]:
    plan = Static(seconds, {}).plans(CARM)[0]
    with open_bench(CARM, BenchOptions("lockstep:"), plan.start_pose) as bench:
        bench.commissioning = ("done before",)  # spares the pushes
        SpoilingLink(bench, spoil)
        timing = bench.run(plan, path)
    return timing, read_recording(path)


def _dead_imu(sample: Sample, row: int) -> None:
    if row >= 200:
        sample.imu[:] = np.nan
        sample.imu_counter = -1


def _frozen_imu(sample: Sample, row: int) -> None:
    if row >= 200:
        sample.imu[3] = 0.001


def _jumped_encoder(sample: Sample, row: int) -> None:
    if row >= 200:
        sample.position[ROLL] += 100 * COUNT_rad


def _drifting_encoder(sample: Sample, row: int) -> None:
    sample.position[ROLL] += 2e-4 * max(0, row - 200) / 256


def _warning_drive(sample: Sample, row: int) -> None:
    if 200 <= row < 210:
        sample.statusword[ROLL] |= 0x80


FAULTS = {
    "dead IMU": (_dead_imu, "imu: no packet for more than 0.015 s", "imu", "age", 203),
    "frozen IMU": (_frozen_imu, "imu: rate x has not changed for 8 packets", "imu", "frozen", 207),
    "jump": (_jumped_encoder, "encoders_roll: its motor side jumped by", "encoders_roll", "jump", 200),
    "drift": (_drifting_encoder, "encoders_roll: its link encoder has departed", "encoders_roll", "drift", None),
    "warning": (_warning_drive, "drive_roll: its drive warns", "drive_roll", "warning", 200),
}


@pytest.mark.slow
@pytest.mark.parametrize(("spoil", "says", "sensor", "check", "row"), FAULTS.values(), ids=FAULTS.keys())
def test_a_sensor_that_fails_is_said_marked_and_kept(
    tmp_path: Path, spoil: Spoil, says: str, sensor: str, check: str, row: int | None
) -> None:
    timing, recording = run_spoiled(tmp_path / "run.mf4", spoil)
    (line,) = timing.judged
    assert line.startswith(says)
    assert recording.metadata["judged"]["sensors"] == SENSORS
    (finding,) = recording.metadata["judged"]["findings"]
    assert (finding["sensor"], finding["check"], finding["follows"]) == (sensor, check, "mark")
    marked = np.flatnonzero(recording["sensor_marks"])
    assert set(recording["sensor_marks"]) == {0, 1 << SENSORS.index(sensor)}
    assert len(marked) == finding["rows"]
    assert finding["first_s"] == marked[0] / 256
    assert row is None or marked[0] == row
    assert finding["since_s"] * 256 == pytest.approx(200, abs=130)  # from the fault on, to within a window of the encoders
    (noticed,) = [event for event in recording.metadata["events"] if event["what"] == "sensor judged"]
    assert (noticed["sensor"], noticed["check"]) == (sensor, check)


@pytest.mark.slow
def test_a_hot_winding_stops_the_motors_and_says_so_in_the_recording(tmp_path: Path) -> None:
    def hot(sample: Sample, row: int) -> None:
        if row >= 100:
            sample.temperature_degC[ROLL] = 150.0

    with pytest.raises(LoopAbortedError, match=r"row 100: temperature_roll: 150\.0 degC, 120\.0 are allowed; the motors were stopped"):
        run_spoiled(tmp_path / "run.mf4", hot)
    recording = read_recording(tmp_path / "run.mf4")
    assert recording.metadata["judged"]["findings"][0]["check"] == "limit"
    whats = [event["what"] for event in recording.metadata["events"]]
    assert whats.index("sensor judged") < whats.index("stop asked") < whats.index("session ended")


SOUND = {
    "scan": (CARM, Scan("propeller", -1.7, 1.7, 1.0)),
    "jog": (CARM, Multisine({"roll": 0.5}, amplitude_A=1.0, period_s=10.0, periods=1, settle_periods=1, jog=Jog(0.05, line=1), seed=2)),
    "move": (CARM, Move({"propeller": -1.5, "roll": -1.2}, {"propeller": 1.5, "roll": 1.2})),
    "turntable": (load_machine("turntable"), Scan("turn", -1.0, 1.0, 1.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize(("machine", "experiment"), SOUND.values(), ids=SOUND.keys())
@pytest.mark.parametrize("noise", [True, pytest.param(False, marks=pytest.mark.nightly)], ids=["noise", "no noise"])
def test_sound_sensors_are_not_found_wrong(tmp_path: Path, machine: Machine, experiment: Scan | Multisine | Move, noise: bool) -> None:
    plan = experiment.plans(machine)[0]
    with open_bench(machine, BenchOptions("lockstep:", seed=7, noise=noise), plan.start_pose) as bench:
        bench.commissioning = ("done before",)
        timing = bench.run(plan, tmp_path / "run.mf4")
    assert timing.judged == ()
    assert not read_recording(tmp_path / "run.mf4")["sensor_marks"].any()


def test_the_events_stand_beside_the_recording_as_json_lines_and_inside_it(tmp_path: Path) -> None:
    plan = Static(0.5, {}).plans(CARM)[0]
    with open_bench(CARM, BenchOptions("lockstep:"), plan.start_pose) as bench:
        bench.run(plan, tmp_path / "run.mf4")
    events = [json.loads(line) for line in (tmp_path / "run.events.jsonl").read_text(encoding="utf-8").splitlines()]
    assert events == read_recording(tmp_path / "run.mf4").metadata["events"]
    whats = list(dict.fromkeys(event["what"] for event in events))
    assert whats == [
        "session started",
        "commissioned",
        "drives enabled",
        "brakes open",
        "run begins",
        "run ends",
        "brakes closed, drives disabled",
        "axis stopped",
        "session ended",
    ]
    times = [event["time_s"] for event in events]
    assert times == sorted(times)
    run = {event["what"]: event["time_s"] for event in events}
    assert run["run ends"] - run["run begins"] == pytest.approx(0.5, abs=1e-6)


def test_who_asked_for_a_stop_is_among_the_events(tmp_path: Path) -> None:
    plan = Static(1.0, {}).plans(CARM)[0]
    with pytest.raises(LoopAbortedError), open_bench(CARM, BenchOptions("lockstep:"), plan.start_pose) as bench:
        bench.run(plan, tmp_path / "run.mf4", lambda row: bench.loop.stop_request.ask("asked to stop by SIGINT"))
    events = [json.loads(line) for line in (tmp_path / "run.events.jsonl").read_text(encoding="utf-8").splitlines()]
    (asked,) = [event for event in events if event["what"] == "stop asked"]
    assert (asked["who"], asked["reason"]) == ("operator", "asked to stop by SIGINT")
