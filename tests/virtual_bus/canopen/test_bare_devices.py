"""A bare device of every vendor's file: it boots, says what the file says, and takes whatever comes over the wire."""

from __future__ import annotations

from pathlib import Path

import pytest
from device_wires import DRIVE_EDS, ENCODER_EDS, VENDOR_FILES, Wire, needs_vendor_files
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.canopen.eds import load_object_dictionary
from drivers.errors import ProtocolError
from virtual_bus.canopen.bare import BareMachine, bare_device

FILES = sorted(path for path in VENDOR_FILES.glob("*") if path.suffix in (".eds", ".dcf")) if VENDOR_FILES.is_dir() else []


def wired(eds: Path) -> Wire:
    wire = Wire()
    wire.attach(bare_device(eds, 5, lambda can_id, data: None))
    return wire


@needs_vendor_files
@pytest.mark.parametrize("eds", FILES, ids=lambda path: path.name)
def test_a_vendors_device_boots_and_answers_every_readable_object(eds: Path) -> None:
    wire = wired(eds)
    assert wire.sent == [(0x705, b"\x00")]
    answered = 0
    for entry in wire.device.objects:
        request = bytes((0x40,)) + entry.index.to_bytes(2, "little") + bytes((entry.subindex,)) + bytes(4)
        answer = wire.sdo_raw(request)
        if answer[0] == 0x80:
            assert not entry.readable or entry.index == 0x1003
            continue
        answered += 1
        if answer[0] & 2:
            value = int.from_bytes(answer[4 : 8 - (answer[0] >> 2 & 3)], "little", signed=entry.signed)
            if entry.is_integer and entry.index not in (0x1010, 0x1011):
                assert value == entry.default
    assert answered > 60


@needs_vendor_files
@pytest.mark.parametrize("eds", FILES, ids=lambda path: path.name)
def test_a_vendors_device_goes_through_its_states_with_its_pdos(eds: Path) -> None:
    wire = wired(eds)
    wire.forget()
    wire.command(0x01)
    for _ in range(5):
        wire.frame(0x080)
    wire.pass_time(0.1)
    own = {can_id for can_id, _ in wire.sent}
    allowed = {0x085, 0x705} | {int(e.value) & 0x7FF for e in wire.device.objects if 0x1800 <= e.index < 0x1A00 and e.subindex == 1}  # type: ignore[arg-type]
    assert own <= allowed


frames = st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=30)
sdo_writes = st.tuples(
    st.just(0x605),
    st.builds(
        lambda command, index, sub, value: bytes((command,)) + index.to_bytes(2, "little") + bytes((sub,)) + value,
        st.sampled_from([0x23, 0x2B, 0x2F, 0x40, 0x22, 0x21]),
        st.one_of(st.sampled_from([0x1003, 0x1005, 0x1010, 0x1014, 0x1016, 0x1017, 0x1019]), st.integers(0x1400, 0x1A03)),
        st.integers(0, 8),
        st.binary(min_size=4, max_size=4),
    ),
)
states = st.tuples(st.just(0x000), st.builds(lambda command: bytes((command, 5)), st.sampled_from([1, 2, 128, 129, 130])))


@pytest.mark.slow
@pytest.mark.parametrize("eds", [DRIVE_EDS, ENCODER_EDS], ids=lambda path: path.name)
@settings(max_examples=examples(60), deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(traffic=st.lists(st.one_of(frames.map(lambda many: many[0] if many else (0x080, b"")), sdo_writes, states), max_size=60))
def test_no_traffic_breaks_a_device(eds: Path, traffic: list[tuple[int, bytes]]) -> None:
    wire = wired(eds)
    for can_id, data in traffic:
        wire.frame(can_id, data)
        wire.pass_time(0.002)
    assert all(0 <= can_id <= 0x7FF and len(data) <= 8 for can_id, data in wire.sent)
    wire.command(0x82)
    wire.frame(0x605, bytes.fromhex("80 00 00 00 00 00 00 00"))
    assert wire.sdo_raw(bytes.fromhex("40 00 10 00 00 00 00 00"))[0] == 0x43


def test_a_bare_machine_keeps_the_time_it_is_given() -> None:
    heard: list[tuple[int, bytes]] = []
    machine = BareMachine(DRIVE_EDS, 5)
    machine.connect(lambda can_id, data: heard.append((can_id, data)))
    machine.power_on()
    machine.receive(0x605, bytes.fromhex("2B 17 10 00 64 00 00 00"))
    for _ in range(1000):
        machine.idle(0.001)
    assert [data for can_id, data in heard if can_id == 0x705] == [b"\x00"] + [b"\x7f"] * 11, "at once, then every 100 ms"


def test_a_file_that_is_none_is_named(tmp_path: Path) -> None:
    path = tmp_path / "nothing.eds"
    path.write_text("hello\n")
    with pytest.raises(ProtocolError, match=r"nothing\.eds"):
        bare_device(path, 5, lambda can_id, data: None)
    assert load_object_dictionary(DRIVE_EDS, 5).node_id == 5
