"""The emulated machine with another maker's data sheet for one drive: who it says it is, and that it can be powered."""

from __future__ import annotations

import os
import signal
import threading
import warnings
from pathlib import Path

import can
import pytest
from command_line import Isocenter
from device_wires import DRIVE_EDS, VENDOR_FILES
from other_makers import dictionary_of

from drivers.bus_url import open_bus
from hil.emulated.machine import emulate_machine, with_data_sheet
from hil.machine import load_machine

WAIT_S = 20.0  # a bound for a loaded machine, not an expectation
SYNCS = 1000  # in which a drive must have changed its state
SYNC = can.Message(arbitration_id=0x080, is_extended_id=False)
SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED = 0x40, 0x21, 0x23, 0x27
STATES = ((SWITCH_ON_DISABLED, 0x00), (READY, 0x06), (SWITCHED_ON, 0x07), (ENABLED, 0x0F))


def ask(bus: can.BusABC, node_id: int, request: str) -> int:
    """The value of an expedited SDO answer."""
    bus.send(can.Message(arbitration_id=0x600 + node_id, data=bytes.fromhex(request), is_extended_id=False))
    while True:
        message = bus.recv(WAIT_S)
        assert message is not None, "no answer"
        if message.arbitration_id == 0x580 + node_id:
            assert message.data[0] != 0x80, message
            return int.from_bytes(message.data[4:8], "little")


def state(bus: can.BusABC) -> int:
    word = ask(bus, 2, "40 41 60 00 00 00 00 00") & 0xFFFF
    return word & (0x4F if word & 0x4F == SWITCH_ON_DISABLED else 0x6F)


@pytest.mark.parametrize("maker", ["another", "elmo_gold.dcf"])
def test_it_answers_with_the_makers_identity_and_is_powered_step_by_step(tmp_path: Path, maker: str) -> None:
    eds = VENDOR_FILES / maker
    if maker == "another":
        eds = tmp_path / "another.eds"
        before, mark, after = DRIVE_EDS.read_text().partition("[1018sub1]")
        eds.write_text(before + mark + after.replace("DefaultValue=0x00000000", "DefaultValue=0x0000ABCD", 1))
    elif not eds.is_file():
        pytest.skip(f"{eds} is not here: makers' data sheets are not part of the project")
    identity, found = dictionary_of(eds)[0x1018], []

    def work() -> None:
        try:
            with open_bus(f"virtual:{maker}", 1_000_000) as bus:
                found.extend(ask(bus, node, f"40 18 10 0{sub} 00 00 00 00") for node, sub in ((2, 1), (2, 2), (1, 2)))
                bus.send(can.Message(arbitration_id=0x000, data=[1, 2], is_extended_id=False))
                ask(bus, 2, "2F 60 60 00 08 00 00 00" if maker == "elmo_gold.dcf" else "2F 60 60 00 0A 00 00 00")
                for expected, word in STATES:
                    ask(bus, 2, f"2B 40 60 00 {word:02X} 00 00 00")
                    for _ in range(SYNCS):
                        if state(bus) == expected:
                            break
                        bus.send(SYNC)
                    found.append(state(bus))
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    client = threading.Thread(target=work)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of repairs of data sheets
        machine = with_data_sheet(load_machine("carm"), "drive:roll", eds)
        emulate_machine(machine, f"virtual:{maker}", {}, punctual=False, on_ready=lambda _: client.start())
    client.join()
    vendor, product = (identity[sub].default or 0 for sub in (1, 2))
    assert (vendor, product) != (0, 0x49534F01)
    assert found == [vendor, product, 0x49534F01, *(expected for expected, _ in STATES)]


@pytest.mark.parametrize("device", ["drive:propeller", "encoder:roll"])
def test_no_other_device_of_the_machine_changes(device: str) -> None:
    carm = load_machine("carm")
    assert carm.bus is not None
    bus = with_data_sheet(carm, device, DRIVE_EDS).bus
    assert bus is not None
    for new, old in zip(bus.nodes, carm.bus.nodes, strict=True):
        expected = DRIVE_EDS if f"{new.role}:{new.axis}" == device else old.eds
        assert (new.eds, new.node_id) == (expected, old.node_id)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--eds", DRIVE_EDS, "--as", "drive:elbow"), "--as drive:elbow: carm has no such device; it has drive:propeller, drive:roll"),
        (("--eds", DRIVE_EDS, "--as", "pump:roll"), "--as pump:roll: carm has no such device"),
        (("emps", "--eds", DRIVE_EDS, "--as", "drive:roll"), "emps has no such device; its file has no [bus]"),
        (("carm", "--as", "drive:roll"), "--as drive:roll: needs --eds FILE"),
        (("--eds", DRIVE_EDS, "--as", "drive:roll", "--node", 9), "--node 9: with --as drive:roll the machine file says the node id"),
        (("carm", "--node", 9), "--node: is for a device of --eds FILE"),
        (("--eds", "absent.eds", "--as", "drive:roll"), "absent.eds: no such EDS file"),
        (("--eds", DRIVE_EDS.with_name("isocenter_encoder.eds"), "--as", "drive:roll"), "no data sheet of a CiA 402 drive"),
    ],
)
def test_what_does_not_fit_is_one_line(isocenter: Isocenter, arguments: tuple[object, ...], says: str) -> None:
    refused = isocenter("emulate", *arguments, "--bus", "virtual:refused", "--no-real-time")
    assert refused.status == 2
    assert says in refused.line
