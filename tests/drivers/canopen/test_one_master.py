"""Somebody else who sends what only the bench, or one device, may send: named in one line within ten ticks, and the machine is at rest."""

from __future__ import annotations

import struct
from collections.abc import Callable

import can
import pytest
from machine_rig import ZERO, Rig
from scripted_nodes import PERIOD_S

from drivers.errors import BusError, DeviceFaultError, SecondMasterError

TICKS = 10
SECOND = 256


class Intruded(Rig):
    """Two axes, and somebody who speaks at every SYNC once told to."""

    def __init__(self) -> None:
        super().__init__()
        self.speak: Callable[[], None] = lambda: None

    def exchange(self, ticks: int) -> None:
        for _ in range(ticks):
            self.speak()
            self.machine.exchange(ZERO)


@pytest.fixture
def rig() -> Intruded:
    rig = Intruded()
    rig.ready()
    rig.exchange(SECOND)  # long enough for every heartbeat to have come
    return rig


def refused(rig: Intruded, words: str, ticks: int = TICKS) -> None:
    with pytest.raises(SecondMasterError, match=words) as caught:
        rig.exchange(ticks)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, BusError)
    assert rig.at_rest()


def test_a_second_sync_producer(rig: Intruded) -> None:
    rig.speak = lambda: rig.bus.emit(0x080, b"")
    refused(rig, "a second SYNC producer sends 080h on scripted; switch it off", ticks=1)


def test_a_sync_once_in_a_second_is_one_too_many(rig: Intruded) -> None:
    rig.bus.emit(0x080, b"\x01")
    refused(rig, "a second SYNC producer", ticks=1)


@pytest.mark.parametrize(("identifier", "name"), [(0x201, "propeller_drive"), (0x202, "roll_drive")])
def test_a_second_sender_of_target_torque(rig: Intruded, identifier: int, name: str) -> None:
    rig.speak = lambda: rig.bus.emit(identifier, struct.pack("<Hh", 0x0F, 300))
    refused(rig, f"somebody else sends {identifier:03X}h, the commands to {name}, on scripted; switch it off", ticks=1)


def test_a_foreign_heartbeat_of_the_benchs_own_id(rig: Intruded) -> None:
    rig.bus.emit(0x77F, b"\x05")
    refused(rig, "a second master sends the bench's own heartbeat, 77Fh, on scripted", ticks=1)


@pytest.mark.parametrize(
    ("identifier", "data", "who"),
    [(0x181, bytes(8), "propeller_drive: TPDO 1"), (0x18C, bytes(4), "roll_encoder: TPDO 1")],
)
def test_a_second_sender_of_a_devices_process_data(rig: Intruded, identifier: int, data: bytes, who: str) -> None:
    if identifier == 0x181:
        data = struct.pack("<Hih", 0x237, 1000, 0)
    rig.speak = lambda: rig.bus.emit(identifier, data)
    refused(rig, rf"{who} \({identifier:03X}h\) comes more than once per SYNC: a second device sends it on scripted; switch it off")


def test_a_second_sender_after_a_frame_was_lost(rig: Intruded) -> None:
    rig.encoders[1].mute_pdo = True
    rig.exchange(1)
    rig.encoders[1].mute_pdo = False
    rig.speak = lambda: rig.bus.emit(0x18C, bytes(4))
    refused(rig, "roll_encoder: TPDO 1")


def test_a_frame_too_many_now_and_then_is_none(rig: Intruded) -> None:
    for _ in range(20):
        rig.bus.emit(0x18C, bytes(4))
        rig.exchange(SECOND + 10)


def test_frames_held_up_for_many_ticks_that_come_all_at_once_are_no_second_sender(rig: Intruded) -> None:
    encoder = rig.encoders[1]
    for _ in range(6):
        encoder.mute_pdo = True
        rig.exchange(50)
        encoder.mute_pdo = False
        for _ in range(50):
            rig.bus.emit(0x18C, bytes(4))
        rig.exchange(5)


@pytest.mark.parametrize("phase", [0.1, 0.3, 0.5, 0.9])
def test_two_heartbeats_of_one_node_are_named_within_half_a_second(rig: Intruded, phase: float) -> None:
    beats = iter(range(1000))
    rig.exchange(round(phase * 0.1 / PERIOD_S))
    begin_s, sent = rig.bus.time_s, [0]

    def speak() -> None:
        if rig.bus.time_s >= begin_s + 0.1 * sent[0]:
            sent[0] = next(beats) + 1
            rig.bus.emit(0x702, b"\x05")

    rig.speak = speak
    refused(rig, r"roll_drive \(node 2\): its heartbeat comes more often than every 0.1 s: a second device has its id", ticks=128)


def test_heartbeats_that_were_held_up_are_no_second_device(rig: Intruded) -> None:
    for _ in range(10):
        for _ in range(7):
            rig.bus.emit(0x702, b"\x05")  # the bench stood still for 0.7 s
        rig.exchange(130)


@pytest.mark.parametrize(("state", "words"), [(0x00, "rebooted"), (0x7F, "left operational: pre-operational")])
def test_another_state_between_two_heartbeats_may_be_another_devices(rig: Intruded, state: int, words: str) -> None:
    while not rig.bus.queue:
        rig.bus.pass_time(0.001)  # until a heartbeat is due
    rig.exchange(3)
    rig.bus.emit(0x702, bytes((state,)))
    with pytest.raises(
        DeviceFaultError, match=rf"roll_drive \(node 2\): {words}; it came between two heartbeats, so a second device may have its id"
    ):
        rig.exchange(1)
    assert rig.at_rest()


def test_a_flood_is_named_and_other_devices_traffic_is_not(rig: Intruded) -> None:
    def speak_of(frames: int) -> Callable[[], None]:
        return lambda: [rig.bus.emit(0x3A5, bytes(8)) for _ in range(frames)] and None

    rig.speak = speak_of(12)  # a third of what the bus can carry
    rig.exchange(SECOND)
    rig.speak = speak_of(200)
    rig.exchange(1)  # what waited during a pause
    rig.speak = speak_of(30)
    refused(rig, r"3\d frames in one period that nobody here asked for, the last with the identifier 3A5h, 17 are bearable")


def test_a_machine_starts_again_after_the_intruder_has_gone(rig: Intruded) -> None:
    rig.bus.emit(0x080, b"")
    refused(rig, "a second SYNC producer", ticks=1)
    rig.ready()
    rig.exchange(SECOND)


def test_a_second_master_that_is_there_before_the_start_is_named_and_the_bench_sends_nothing() -> None:
    rig = Rig()
    tick = rig.drives[0].tick

    def ticking(now_s: float) -> None:
        tick(now_s)
        if not rig.bus.queue:
            rig.bus.emit(0x080, b"")

    rig.drives[0].tick = ticking
    with pytest.raises(SecondMasterError, match="a second SYNC producer sends 080h"):
        rig.machine.start()
    assert {identifier for _, identifier, _ in rig.bus.log} == {0x080}
    assert not rig.machine.syncs


class Echoing(Intruded):
    """An adapter that hands the bench its own frames, too."""

    def __init__(self) -> None:
        super().__init__()
        send = self.bus.send

        def echoing(msg: can.Message, timeout: float | None = None) -> None:
            self.bus.queue.append(can.Message(arbitration_id=msg.arbitration_id, is_extended_id=False, data=bytes(msg.data)))
            send(msg, timeout)

        self.bus.send = echoing


def test_an_adapter_that_echoes_accuses_nobody_and_still_hears_a_second_master() -> None:
    rig = Echoing()
    rig.ready()
    assert rig.machine.network.echoes
    rig.exchange(3 * SECOND)
    rig.speak = lambda: rig.bus.emit(0x201, struct.pack("<Hh", 0x0F, 300))
    refused(rig, "somebody else sends 201h")


def test_an_adapter_that_does_not_echo_is_known_as_such(rig: Intruded) -> None:
    assert not rig.machine.network.echoes
