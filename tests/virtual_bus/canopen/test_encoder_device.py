"""The CiA 406 encoder on the wire."""

from __future__ import annotations

import struct

import canopen
import pytest
from canopen import RemoteNode
from device_wires import ENCODER_EDS, Wire, abort_code, client, encoder_settings, u8, u16, u32

from virtual_bus.canopen.encoder import Cia406Encoder

TURN = 8388608


@pytest.fixture
def encoder() -> tuple[Wire, canopen.RemoteNode, Cia406Encoder]:
    wire = Wire()
    device = Cia406Encoder(encoder_settings(node_id=4), lambda can_id, data: None)
    wire.attach(device)
    return wire, client(wire, ENCODER_EDS), device


@pytest.mark.parametrize(("counts", "shown"), [(0, 4194304), (100, 4194404), (-4194304, 0), (-4194305, TURN - 1), (4194304, 0)])
def test_the_position_counts_from_where_it_was_mounted_and_wraps_in_one_turn(
    encoder: tuple[Wire, RemoteNode, Cia406Encoder], counts: int, shown: int
) -> None:  # type: ignore[no-untyped-def]
    _, remote, device = encoder
    device.latch(counts)
    assert remote.sdo[0x6004].raw == shown


def test_it_says_what_it_is(encoder: tuple[Wire, RemoteNode, Cia406Encoder]) -> None:  # type: ignore[no-untyped-def]
    _, remote, _ = encoder
    assert remote.sdo[0x1000].raw & 0xFFFF == 406
    assert remote.sdo[0x1000].raw >> 16 == 1, "absolute rotary encoder, single turn"
    assert (remote.sdo[0x6501].raw, remote.sdo[0x6502].raw, remote.sdo[0x6002].raw) == (TURN, 1, TURN)
    assert remote.sdo[0x1018][2].raw == 0x49534F02


def test_a_preset_shifts_the_position_and_shows_in_the_offset(encoder: tuple[Wire, RemoteNode, Cia406Encoder]) -> None:  # type: ignore[no-untyped-def]
    _, remote, device = encoder
    device.latch(1000)
    remote.sdo[0x6003].raw = 77
    assert remote.sdo[0x6004].raw == 77
    assert remote.sdo[0x6509].raw == 77 - (4194304 + 1000)
    device.latch(1010)
    assert remote.sdo[0x6004].raw == 87
    remote.sdo[0x6003].raw = 5
    assert (remote.sdo[0x6004].raw, remote.sdo[0x6509].raw) == (5, 5 - (4194304 + 1010)), "a second one replaces the first"
    assert abort_code(lambda: remote.sdo.download(0x6003, 0, u32(TURN))) == 0x06090031


def test_a_saved_preset_survives_a_reset_and_an_unsaved_one_does_not(encoder: tuple[Wire, RemoteNode, Cia406Encoder]) -> None:  # type: ignore[no-untyped-def]
    wire, remote, device = encoder
    device.latch(1000)
    remote.sdo[0x6003].raw = 77
    wire.command(0x81)
    assert remote.sdo[0x6004].raw == 4194304 + 1000
    remote.sdo[0x6003].raw = 77
    remote.sdo.download(0x1010, 1, b"save")
    wire.command(0x81)
    assert remote.sdo[0x6004].raw == 77


def test_the_direction_can_be_reversed(encoder: tuple[Wire, RemoteNode, Cia406Encoder]) -> None:  # type: ignore[no-untyped-def]
    _, remote, device = encoder
    device.latch(1000)
    remote.sdo[0x6000].raw = 0x0005
    assert remote.sdo[0x6004].raw == (-(4194304 + 1000)) % TURN
    device.latch(1001)
    assert remote.sdo[0x6004].raw == (-(4194304 + 1001)) % TURN
    assert abort_code(lambda: remote.sdo.download(0x6000, 0, u16(0x0002))) == 0x06090030


def test_the_measuring_range_can_be_shortened_and_not_lengthened(encoder: tuple[Wire, RemoteNode, Cia406Encoder]) -> None:  # type: ignore[no-untyped-def]
    _, remote, device = encoder
    remote.sdo[0x6002].raw = 1000
    device.latch(0)
    assert remote.sdo[0x6004].raw == 4194304 % 1000
    assert abort_code(lambda: remote.sdo.download(0x6002, 0, u32(TURN + 1))) == 0x06090031


def test_the_cyclic_timer_sends_the_position(encoder: tuple[Wire, RemoteNode, Cia406Encoder]) -> None:  # type: ignore[no-untyped-def]
    wire, remote, device = encoder
    remote.sdo[0x6200].raw = 20
    assert remote.sdo[0x1800][5].raw == 20
    wire.command(0x01)
    wire.forget()
    device.latch(5)
    wire.pass_time(0.2005)
    frames = wire.heard(0x184)
    assert set(frames) == {u32(4194309)}
    assert 10 <= len(frames) <= 11


def test_the_position_comes_with_every_sync(encoder: tuple[Wire, RemoteNode, Cia406Encoder]) -> None:  # type: ignore[no-untyped-def]
    wire, remote, device = encoder
    remote.sdo.download(0x1801, 2, u8(1))
    remote.sdo.download(0x1801, 1, u32(0x40000284))
    wire.command(0x01)
    for counts in (1, -1):
        device.latch(counts)
        wire.frame(0x080)
    assert [struct.unpack("<I", data)[0] for data in wire.heard(0x284)] == [4194305, 4194303]


def test_an_encoder_mounted_the_other_way_round_counts_backwards() -> None:
    wire = Wire()
    device = Cia406Encoder(encoder_settings(node_id=4, sign=-1), lambda can_id, data: None)
    wire.attach(device)
    device.latch(10)
    assert client(wire, ENCODER_EDS).sdo[0x6004].raw == 4194294
