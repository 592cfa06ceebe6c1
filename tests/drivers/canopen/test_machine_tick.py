"""The tick of a whole machine: frames and their order, scaling, missing, late and damaged data."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable

import numpy as np
import pytest
from machine_rig import RESOLUTION, ZERO, Rig
from scripted_nodes import PERIOD_S

from drivers.errors import (
    MotionRefusedError,
)
from drivers.interface import Sample
from drivers.machine_link import CanMachine
from drivers.settings import ImuPort, Pdo


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_a_tick_is_rpdos_then_sync_then_tpdos_and_the_effort_answers_to_the_command(rig: Rig) -> None:
    rig.ready()
    rig.bus.log.clear()
    sample = rig.machine.exchange(np.array([1.0, -2.5]))
    frames = [(can_id, data.hex(" ")) for _, can_id, data in rig.bus.log if can_id < 0x700]
    assert frames[:3] == [(0x201, "0f 00 c8 00"), (0x202, "0f 00 0c fe"), (0x080, "")]  # 200 and -500 per mille of 5 A
    assert [can_id for can_id, _ in frames[3:]] == [0x181, 0x182, 0x18B, 0x18C]
    assert sample.effort == pytest.approx([1.0, -2.5])
    assert sample.statusword.tolist() == [0x237, 0x237]
    assert sample.age_s.tolist() == [0.0, 0.0]


def test_split_and_swapped_rpdos_carry_the_same_values(rig: Rig) -> None:
    drives = list(rig.settings.nodes[:2])
    drives[0] = dataclasses.replace(drives[0], rpdos=(Pdo(1, 0x201, 1, ((0x6071, 0, 16), (0x6040, 0, 16))),))
    drives[1] = dataclasses.replace(drives[1], rpdos=(Pdo(1, 0x202, 1, ((0x6040, 0, 16),)), Pdo(2, 0x302, 1, ((0x6071, 0, 16),))))
    rig.machine = CanMachine(dataclasses.replace(rig.settings, nodes=(*drives, *rig.settings.nodes[2:])), rig.bus, rig.clock)
    rig.machine.start()
    rig.bus.log.clear()
    rig.machine.exchange(np.array([1.0, -2.5]))
    assert [data.hex() for _, can_id, data in rig.bus.log if can_id in (0x201, 0x202, 0x302)] == ["c8000000", "0000", "0cfe"]


def test_commands_are_clipped_to_the_axis_limit(rig: Rig) -> None:
    rig.ready()
    sample = rig.machine.exchange(np.array([9.0, -1e6]))
    assert sample.effort == pytest.approx([8.0, -8.0])


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_command_that_is_no_number_is_not_sent_and_stops_the_machine(rig: Rig, value: float) -> None:
    rig.ready()
    with pytest.raises(MotionRefusedError, match="roll: the command is"):
        rig.machine.exchange(np.array([0.0, value]))
    assert rig.at_rest()


def test_a_reversed_axis_reverses_position_and_effort_together() -> None:
    rig = Rig(sign=-1)
    rig.ready()
    before = rig.machine.exchange(ZERO).position.copy()
    sample = rig.machine.exchange(np.array([1.0, 0.0]))
    assert struct.unpack("<h", rig.drives[0].objects[0x6071, 0])[0] == -200
    assert sample.effort[0] == pytest.approx(1.0)
    assert sample.position[0] > before[0]


def test_the_own_heartbeat_goes_out_by_tick_count_behind_the_rpdos(rig: Rig) -> None:
    rig.ready()
    rig.bus.log.clear()
    for _ in range(100):
        rig.machine.exchange(ZERO)
    ids = [can_id for _, can_id, _ in rig.bus.log]
    beats = [k for k, can_id in enumerate(ids) if can_id == 0x77F]
    assert len(beats) == 4  # 0.1 s is 25.6 ticks: every 25
    assert all(ids[k - 1] == 0x202 and ids[k + 1] == 0x080 for k in beats)
    syncs = [ids[:k].count(0x080) for k in beats]
    assert set(np.diff(syncs)) == {25}


def test_runs_are_repeatable_frame_by_frame() -> None:
    logs = []
    for _ in range(2):
        rig = Rig().ready()
        for k in range(50):
            rig.machine.exchange(np.array([0.1 * (k % 7), -0.1]))
        rig.machine.close()
        logs.append(rig.bus.log)
    assert logs[0] == logs[1]


def test_a_missing_pdo_is_nan_in_its_row_and_ages(rig: Rig) -> None:
    rig.ready()
    rig.drives[1].mute_pdo = True
    for k in range(1, 4):
        sample = rig.machine.exchange(ZERO)
        assert np.isfinite(sample.position[0])
        assert np.isnan(sample.position[1])
        assert np.isnan(sample.effort[1])
        assert sample.statusword[1] == -1
        assert sample.age_s == pytest.approx([0.0, k * PERIOD_S])
    rig.drives[1].mute_pdo = False
    sample = rig.machine.exchange(ZERO)
    assert np.isfinite(sample.position[1])
    assert sample.age_s[1] == 0.0


def test_waiting_for_a_missing_pdo_ends_with_the_answer_time(rig: Rig) -> None:
    rig.ready()
    rig.drives[1].mute_pdo = True
    start = rig.bus.time_s
    rig.machine.exchange(ZERO)
    assert rig.bus.time_s - start == pytest.approx(PERIOD_S + 0.0025, abs=1e-9)


class SilentImu:
    """Configured, and then nothing."""

    looks = malformed = checksum_errors = 0

    def configure(self, wait: Callable[..., object]) -> None:
        pass

    def before_sync(self) -> None:
        self.looks = 0

    def poll(self, sample: Sample) -> bool:
        self.looks += 1
        assert self.looks < 1000, "time stands still"
        return False


def test_a_silent_imu_is_waited_for_until_the_answer_time_whatever_the_time_is(rig: Rig) -> None:
    settings = dataclasses.replace(rig.settings, imu=ImuPort("imu", "", 921600, triggered_by_sync=True, rate_Hz=256.0))
    rig.machine = CanMachine(settings, rig.bus, rig.clock, SilentImu(), rig.io)
    rig.machine.start()
    patience_s = settings.answer_timeout_s
    while rig.bus.time_s < 1.98:
        rig.machine.exchange(ZERO)
    starts = np.linspace(1.99, 2.0, 2000)
    syncs = starts + PERIOD_S
    rounded_up = starts[syncs + patience_s - patience_s > syncs]
    assert len(rounded_up) > 5
    for start in rounded_up[:5].tolist():
        rig.bus.time_s = start
        rig.machine.exchange(ZERO)
        assert rig.bus.time_s == pytest.approx(start + PERIOD_S + patience_s, abs=1e-4)


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next_syncs(rig: Rig) -> None:
    rig.ready()
    last = rig.encoders[1]
    last.mute_pdo = True
    rig.machine.exchange(ZERO)
    rig.bus.emit(0x18C, struct.pack("<I", 4194304 + 99999))  # what the encoder owed to the last SYNC
    last.mute_pdo = False
    sample = rig.machine.exchange(ZERO)
    assert sample.link_position[1] == pytest.approx((last.value(0x6004) - 4194304) * 2 * math.pi / 2**23)


def test_a_pdo_that_is_too_short_is_counted_and_is_no_value(rig: Rig) -> None:
    rig.ready()
    rig.drives[0].set(0x1A00, 0, 1)
    sample = rig.machine.exchange(ZERO)
    assert np.isnan(sample.position[0])
    assert sample.fault == ""
    assert rig.machine.network.malformed == 1
    assert rig.machine.network.first_malformed == "propeller_drive: TPDO 1 (181h): PDO of 2 bytes where 8 are mapped"


@pytest.mark.parametrize("step", [1, -1])
def test_the_position_runs_on_where_the_drives_counter_wraps(rig: Rig, step: int) -> None:
    rig.ready()
    edge = 2**31 - 3 if step > 0 else -(2**31) + 2
    for counts in (edge // 2, edge):  # a step of more than half the counter's range would itself look like a wrap
        rig.drives[0].counts = float(counts)
        before = rig.machine.exchange(ZERO).position[0]
    for k in range(1, 8):
        counts = edge + step * k
        rig.drives[0].counts = float((counts + 2**31) % 2**32 - 2**31)
        assert rig.machine.exchange(ZERO).position[0] == pytest.approx(before + step * k * RESOLUTION, abs=1e-9)


def test_link_positions_come_from_the_absolute_encoder(rig: Rig) -> None:
    rig.ready()
    rig.drives[1].link_counts = 4194304 + 1000
    assert rig.machine.exchange(ZERO).link_position[1] == pytest.approx(1000 * 2 * math.pi / 2**23)
