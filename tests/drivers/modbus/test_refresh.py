"""The word that keeps outputs on, and a device that checks it."""

from __future__ import annotations

import struct

from drivers.modbus.refresh import FIRST_WORD, WORD_BITS, following_word
from virtual_bus.modbus.io_device import EmulatedIo, IoLayout

LAYOUT = IoLayout(1, {"a": 0}, {"a": 0}, 1, 2, {}, watchdog_register=3, watchdog_timeout_s=0.5)
OPEN = bytes((5,)) + struct.pack(">HH", 0, 0xFF00)


def shown(device: EmulatedIo) -> int:
    answer = device.serve_pdu(bytes((3,)) + struct.pack(">HH", 3, 1))
    return int(struct.unpack(">xxH", answer)[0])


def write(device: EmulatedIo, word: int, register: int = 3) -> bytes:
    return device.serve_pdu(bytes((6,)) + struct.pack(">HH", register, word))


def test_every_word_comes_once() -> None:
    word, seen = FIRST_WORD, set()
    while word not in seen:
        seen.add(word)
        word = following_word(word)
    assert len(seen) == (1 << WORD_BITS) - 1
    assert 0 not in seen


def test_outputs_stay_on_while_the_word_is_followed_and_fall_without() -> None:
    device = EmulatedIo(LAYOUT, ("a",))
    time_s = 0.0
    assert write(device, following_word(shown(device)))[0] == 6
    device.advance(time_s)
    device.serve_pdu(OPEN)
    for _ in range(100):
        time_s += 0.1
        write(device, following_word(shown(device)))
        device.advance(time_s)
    assert not device.brakes_closed[0]
    device.advance(time_s + 0.49)
    assert not device.brakes_closed[0]
    device.advance(time_s + 0.5)
    device.advance(time_s + 0.6)
    assert device.brakes_closed[0]
    write(device, following_word(shown(device)))
    device.advance(time_s + 0.7)
    device.advance(time_s + 0.8)
    assert device.brakes_closed[0]  # until it is told to open again
    device.serve_pdu(OPEN)
    device.advance(time_s + 0.8)
    device.advance(time_s + 0.9)
    assert not device.brakes_closed[0]


def test_a_word_that_is_repeated_kept_or_made_up_refreshes_nothing() -> None:
    device = EmulatedIo(LAYOUT, ("a",))
    first = following_word(shown(device))
    assert write(device, first)[0] == 6
    device.advance(0.0)
    device.serve_pdu(OPEN)
    for wrong in (first, following_word(first) ^ 1, 0):
        assert write(device, wrong) == bytes((0x86, 3))
    assert write(device, following_word(first), register=2) == bytes((0x86, 2))
    device.advance(0.6)
    device.advance(0.7)
    assert device.brakes_closed[0]


def test_a_device_without_a_watchdog_has_no_holding_registers() -> None:
    device = EmulatedIo(IoLayout(1, {"a": 0}, {"a": 0}, 1, 2, {}), ("a",))
    assert write(device, 1) == bytes((0x86, 1))
    assert device.serve_pdu(bytes((3,)) + struct.pack(">HH", 0, 1)) == bytes((0x83, 1))
    device.serve_pdu(OPEN)
    device.advance(0.0)
    device.advance(100.0)
    assert not device.brakes_closed[0]
