"""Bytes that are no message, on every line and at both of its ends: they are counted and dropped, and nobody obeys them.

Random items from fixed seeds, 22,700 in all; each test says in its loop how many are its own.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from random import Random

import can
import canopen
import msgpack
import numpy as np
from can.interfaces.udp_multicast.utils import pack_message
from device_wires import DRIVE_EDS
from imu_wiring import IMU, PERIOD_S, no_wait
from imu_wiring import Bench as ImuBench
from machine_rig import ZERO, Rig
from modbus_wiring import AXES, WIRING, emulated_io, io_map
from pymodbus.pdu.bit_message import ReadDiscreteInputsRequest
from refusals import answer_or_refusal
from scripted_nodes import BusClock, ScriptedBus, ScriptedNode

from drivers.canopen.network import PolledNetwork
from drivers.canopen.sdo import SdoNode
from drivers.errors import ConfigurationRefusedError, DriverError, ProtocolError
from drivers.interface import Sample
from drivers.modbus.io import IoDriver
from drivers.modbus.transport import InProcessTransport
from drivers.udp_bus import frame_of
from hil.emulated.machine import build_emulated
from hil.machine import load_machine
from virtual_bus.canopen.bare import bare_device
from virtual_bus.canopen.nmt import NmtState
from virtual_bus.modbus.framing import TcpFraming, rtu_frame, tcp_frame
from virtual_bus.modbus.servers import ModbusRtuServer
from virtual_bus.serial.pipe import pipe

UNIT = WIRING["unit_id"]
NMT_STATE_BYTES = {state | toggle for state in (0x00, 0x04, 0x05, 0x7F) for toggle in (0, 0x80)}
NMT_COMMAND_BYTES = {0x01, 0x02, 0x80, 0x81, 0x82}


def damaged(good: bytes, random: Random) -> bytes:
    """A message that was cut, lengthened, or has lost some of its bytes' values."""
    kind = random.randrange(3)
    if kind == 0:
        return good[: random.randrange(len(good))]
    if kind == 1:
        return good + random.randbytes(random.randrange(1, 9))
    changed = bytearray(good)
    for _ in range(random.randrange(1, 6)):
        changed[random.randrange(len(changed))] ^= random.randrange(1, 256)
    return bytes(changed)


# ---- udp: ------------------------------------------------------------------------------------------------


def test_a_datagram_is_a_frame_of_can_2_or_none() -> None:
    random = Random(1)
    good = pack_message(can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes(4)))
    for _ in range(6000):
        frame = frame_of(random.choice((random.randbytes(random.randrange(0, 300)), damaged(good, random))))
        if frame is not None:
            frame._check()
            assert not frame.is_fd
            assert len(frame.data) <= 8


def test_a_datagram_with_a_field_of_another_kind_is_no_frame() -> None:
    random = Random(2)
    fields = msgpack.unpackb(pack_message(can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes(4))))
    others = (None, -1, 2**63, 1.0, True, "", "7", [], [1, 2], {}, b"", b"123456789", float("nan"))
    checked = [name for name in fields if name not in ("timestamp", "channel")]
    for _ in range(1500):
        name, value = random.choice(checked), random.choice(others)
        if type(value) is type(fields[name]) and name.startswith(("is_", "bit", "error")):
            continue  # another kind of frame, and a good one
        assert frame_of(msgpack.packb(fields | {name: value})) is None, (name, value)
    for document in ([], {}, 5, "x", None, [fields], {"data": b""}, {1: 2}):
        assert frame_of(msgpack.packb(document)) is None


# ---- the bench's end of the CAN bus ----------------------------------------------------------------------


def malformed_at_the_bench(random: Random) -> Iterator[can.Message]:
    """Frames with the identifiers of the machine's own nodes, none of them what those send."""
    nodes = (1, 2, 11, 12)
    while True:
        node = random.choice(nodes)
        kind = random.randrange(7)
        identifier, data, flags = 0x180 + node, random.randbytes(random.randrange(0, 9)), {}
        if kind == 0:
            size = 8 if node < 10 else 4
            data = random.randbytes(random.randrange(0, size))
        elif kind == 1:
            identifier, data = 0x700 + node, random.randbytes(random.choice((0, 2, 3, 8)))
        elif kind == 2:
            identifier = 0x700 + node
            data = bytes((random.choice([byte for byte in range(256) if byte not in NMT_STATE_BYTES]),))
        elif kind == 3:
            identifier, data = 0x080 + node, random.randbytes(random.randrange(0, 2))
        elif kind == 4:
            identifier, data = 0x580 + node, random.randbytes(random.randrange(0, 4))
        elif kind == 5:
            identifier = random.choice((0x080, 0x180 + node, 0x200 + node, 0x700 + node, 0x77F))
            flags = random.choice(({"is_remote_frame": True, "data": b"", "dlc": 8}, {"is_extended_id": True}, {"is_fd": True}))
        else:
            identifier, flags = 0x181 & ~0x40, {"is_error_frame": True}
        yield can.Message(**{"arbitration_id": identifier, "is_extended_id": False, "data": data} | flags)


def test_no_malformed_frame_disturbs_the_cyclic_exchange() -> None:
    rig, random = Rig().ready(), Random(3)
    before = [struct.unpack("<h", drive.objects[0x6071, 0])[0] for drive in rig.drives]
    frames = malformed_at_the_bench(random)
    for _ in range(500):
        for _ in range(8):
            rig.bus.queue.append(next(frames))
        sample = rig.machine.exchange(ZERO)
        assert sample.fault == ""
        assert np.isfinite(sample.position).all()
        assert (sample.statusword & 0x6F == 0x27).all()
    assert [struct.unpack("<h", drive.objects[0x6071, 0])[0] for drive in rig.drives] == before
    assert all(drive.brake_open for drive in rig.drives)
    assert rig.machine.network.malformed > 1000
    assert rig.machine.dropped.startswith(f"dropped because malformed: {rig.machine.network.malformed} frames (first: ")


class Babbler(ScriptedNode):
    """Answers every SDO request with anything."""

    def __init__(self, random: Random) -> None:
        super().__init__(5, 0, 0)
        self._random = random

    def _sdo(self, data: bytes) -> None:
        random = self._random
        for _ in range(random.choice((0, 1, 1, 1, 2))):
            head = bytes((random.choice((0x41, 0x43, 0x4F, 0x60, 0x80, 0x00, 0x01, 0x10, 0x20, 0x30, random.randrange(256))),))
            answer = head + (data[1:4] if random.random() < 0.7 else random.randbytes(3)) + random.randbytes(4)
            self.bus.emit(0x585, answer[: random.choice((8, 8, 8, 8, 8, 4, 3, 1, 0))])


def test_the_sdo_client_has_an_answer_or_one_clear_error_whatever_the_node_sends() -> None:
    random = Random(4)
    node = Babbler(random)
    bus = ScriptedBus(node)
    network = PolledNetwork(bus, BusClock(bus))
    sdo = SdoNode(network, 5, "babbler", canopen.import_od(str(DRIVE_EDS)))
    requests = 0
    while requests < 3000:
        index, subindex = random.choice(((0x1000, 0), (0x1008, 0), (0x1018, 1), (0x6041, 0), (0x1017, 0)))
        action = random.choice((sdo.read, sdo.read_integer, sdo.read_text, lambda i, s: sdo.write_integer(i, s, 1)))
        bus.log.clear()
        _, refusal = answer_or_refusal(DriverError, action, index, subindex)
        assert "\n" not in (refusal or "")
        requests += max(1, len(bus.sent(0x605)))
    assert network.malformed > 100


# ---- the emulated nodes' end -----------------------------------------------------------------------------


def test_the_sdo_server_survives_any_request_and_obeys_none_that_is_malformed() -> None:
    random = Random(5)
    sent: list[bytes] = []
    node = bare_device(DRIVE_EDS, 5, lambda can_id, data: sent.append(data))
    node.power_on(0.0)
    good = {(entry.index, entry.subindex): entry.value for entry in node.objects}
    for _ in range(1000):
        node.receive(0x605, random.randbytes(random.choice((0, 1, 2, 3, 4, 5, 6, 7))), 0.0)
    assert {(entry.index, entry.subindex): entry.value for entry in node.objects} == good
    assert node.malformed == 1000
    known = list(good)
    for _ in range(3000):
        index, subindex = random.choice(known)
        head = struct.pack("<BHB", random.randrange(256), index, subindex) if random.random() < 0.6 else random.randbytes(4)
        node.receive(0x605, head + random.randbytes(4), 0.0)
    assert all(len(data) <= 8 for data in sent)


def test_the_emulated_machine_obeys_no_malformed_frame() -> None:
    random = Random(6)
    machine = build_emulated(load_machine("carm"))
    machine.power_on()
    nodes = [*machine.drives.values(), *machine.encoders.values()]
    for node in nodes:
        machine.receive(0x000, bytes((0x01, node.node_id)))
    rpdos = [rpdo for node in nodes for rpdo in node._rpdos if rpdo.alive]
    machine.receive(0x080, b"")
    before, time_s = [[entry.value for entry in node.objects if entry.index >= 0x6000] for node in nodes], machine.time_s
    assert rpdos
    for _ in range(2000):
        kind = random.randrange(5)
        if kind == 0:
            machine.receive(0x000, random.randbytes(random.choice((0, 1, 3, 8))))
        elif kind == 1:
            unknown = random.choice([byte for byte in range(256) if byte not in NMT_COMMAND_BYTES])
            machine.receive(0x000, bytes((unknown, random.choice((0, *(node.node_id for node in nodes))))))
        elif kind == 2:
            rpdo = random.choice(rpdos)
            machine.receive(rpdo.cob_id, random.randbytes(random.randrange(0, rpdo._layout.length)))
        elif kind == 3:
            machine.receive(0x080, random.randbytes(random.randrange(2, 9)))
        else:
            machine.receive(0x600 + random.choice(nodes).node_id, random.randbytes(random.randrange(0, 8)))
    assert [[entry.value for entry in node.objects if entry.index >= 0x6000] for node in nodes] == before
    assert all(node.state is NmtState.OPERATIONAL for node in nodes)
    assert machine.time_s == time_s
    assert all(node.malformed for node in nodes)


def test_a_malformed_heartbeat_keeps_no_master_alive() -> None:
    sent: list[tuple[int, bytes]] = []
    node = bare_device(DRIVE_EDS, 5, lambda can_id, data: sent.append((can_id, data)))
    node.power_on(0.0)
    node.receive(0x605, struct.pack("<BHBI", 0x23, 0x1016, 1, 127 << 16 | 100), 0.0)
    node.receive(0x77F, b"\x05", 0.0)
    for step in range(1, 30):
        node.receive(0x77F, Random(step).randbytes(step % 7 + 2), step * 0.01)
        node.tick(step * 0.01)
    assert [data[:2] for can_id, data in sent if can_id == 0x085] == [b"\x30\x81"]  # EMCY 8130h


# ---- Modbus ----------------------------------------------------------------------------------------------


def test_the_modbus_server_obeys_no_malformed_request() -> None:
    random = Random(7)
    device = emulated_io()
    coils = list(device.coils)
    write = bytes((0x0F,)) + struct.pack(">HHBB", 1, 2, 1, 3)
    bench_end, device_end = pipe()
    server = ModbusRtuServer(device, device_end)
    for _ in range(1500):
        request = tcp_frame(random.randrange(1 << 16), UNIT, random.choice((write[: random.randrange(1, 7)], write + b"\0")))
        if random.random() < 0.5:
            request = request[:2] + random.randbytes(2).replace(b"\0", b"\1") + request[4:]  # another protocol
        device.serve_tcp(TcpFraming(), random.choice((request, random.randbytes(random.randrange(1, 40)))))
    assert device.malformed > 500
    for _ in range(1500):
        request = bytearray(rtu_frame(UNIT, write))
        request[random.randrange(len(request))] ^= random.randrange(1, 256)
        device.serve_rtu(random.choice((bytes(request), request[: random.randrange(len(request))], random.randbytes(random.randrange(40)))))
    bench_end.write(random.randbytes(5000))
    server.poll()
    assert device.coils == coils


def test_the_modbus_transport_has_an_answer_or_one_clear_error_whatever_the_device_sends() -> None:
    random = Random(8)
    good = tcp_frame(1, UNIT, b"\x02\x01\x03")
    said = b""
    transport = InProcessTransport(lambda request: request[:2] + said[2:])
    for _ in range(2000):
        said = random.choice((damaged(good, random), good[:7] + random.randbytes(random.randrange(0, 30)), random.randbytes(12)))
        request = ReadDiscreteInputsRequest(address=8, count=2, dev_id=UNIT)
        answer, refusal = answer_or_refusal((ProtocolError, ConfigurationRefusedError), transport.request, request)
        assert answer.function_code == 2 if answer is not None else "\n" not in refusal


def test_what_the_io_says_wrongly_changes_nothing_but_its_age() -> None:
    random = Random(9)
    device, broken = emulated_io(), False
    driver = IoDriver(io_map(), InProcessTransport(lambda request: random.randbytes(11) if broken else device.serve(request)), AXES)
    driver.poll_due(0.0)
    broken = True
    for poll in range(1, 201):
        driver.poll_due(poll * 0.0625)
    driver.update(sample := Sample(2))
    assert driver.malformed == 200
    assert sample.io_age_s == 12.5
    assert not sample.hold_to_run


# ---- the serial line -------------------------------------------------------------------------------------


def test_neither_end_of_the_serial_line_takes_a_damaged_message_for_one() -> None:
    random, bench = Random(10), ImuBench()
    bench.driver.configure(no_wait)
    assert bench.tick(1)
    state, good = bench.device.state, encode_reading_of(bench)
    for _ in range(1500):
        broken = bytearray(good)
        broken[random.randrange(len(broken))] ^= 1 << random.randrange(8)
        bench.device_end.write(random.choice((bytes(broken), random.randbytes(random.randrange(1, 60)))))
        assert not bench.driver.poll(bench.sample)
        assert np.isnan(bench.sample.imu).all()
    assert bench.driver.checksum_errors > 100
    for _ in range(500):
        bench.device.receive(random.randbytes(random.randrange(1, 60)))
    assert bench.device.state is state
    for number in range(2, 80):  # what waits for its end is over by then
        bench.tick(number)
    assert bench.tick(80)
    assert np.array_equal(bench.sample.imu, IMU)


def encode_reading_of(bench: ImuBench) -> bytes:
    return bench.device.on_sync(IMU, 1.5 * PERIOD_S)
