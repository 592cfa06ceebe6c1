"""An emulator that measures ahead of a SYNC answers it as one that does not: bit for bit, whatever comes in between."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Static
from hil.machine import Machine, load_machine
from hil.machine.effects_file import effects_from_text
from virtual_bus.machine import EmulatedMachine
from virtual_bus.physics import Physics
from virtual_bus.sensors.sensing import Latched

CARM = load_machine("carm")
SENSOR_EFFECTS = """
[[effect]]
name = "sample_dropout"
at = "position_roll"
p = 0.2
length = 3
seed = 5

[[effect]]
name = "imu_bandwidth"
at = "imu"
fc_Hz = 40.0
"""


def frames(folder: Path, name: str, emulated: Machine) -> str:
    """Every frame of a session on lockstep: boot, homing, brakes, half a second at rest."""
    plan = Static(0.5).plans(CARM)[0]
    log = folder / f"{name}.log"
    with open_bench(CARM, BenchOptions("lockstep:", frame_log=log, emulated=emulated), plan.start_pose) as bench:
        bench.run(plan, folder / f"{name}.csv")
    return log.read_text() + (folder / f"{name}.csv").read_text()


@pytest.fixture
def prepared(monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[bool]]:
    """Whether each preparation was used, once emulated machines prepare ahead of every SYNC."""
    used: list[bool] = []
    receive, latch = EmulatedMachine.receive, Physics.latch

    def receive_prepared(self: EmulatedMachine, can_id: int, data: bytes) -> None:
        if can_id == self.bus.sync_cob_id:
            self.prepare()
        receive(self, can_id, data)
        if can_id != self.bus.sync_cob_id:
            self.prepare()  # too early: the other drive's target and more may be to come

    def noted_latch(self: Physics) -> Latched:
        used.append(self._prepared == (self._effort.tobytes(), self._brakes.tobytes()))
        return latch(self)

    def switch_on() -> list[bool]:
        monkeypatch.setattr(EmulatedMachine, "receive", receive_prepared)
        monkeypatch.setattr(Physics, "latch", noted_latch)
        return used

    return switch_on


@pytest.mark.slow
@pytest.mark.parametrize("effects", ["", SENSOR_EFFECTS], ids=["as the file has it", "with effects on its sensors"])
def test_a_session_has_the_same_frames_and_rows_whether_the_emulator_measured_ahead_or_not(
    tmp_path: Path, prepared: Callable[[], list[bool]], effects: str
) -> None:
    emulated = CARM.with_effects(effects_from_text(effects, CARM, "effects")) if effects else CARM
    plain = frames(tmp_path, "run", emulated)
    used = prepared()
    (tmp_path / "run.csv").unlink()
    assert frames(tmp_path, "run", emulated) == plain
    assert sum(used) > 0.9 * len(used), "what was measured ahead is what was asked for, but for the few SYNCs of homing"
    assert not all(used), "and when it was not, it was measured anew"
