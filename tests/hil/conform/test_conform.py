"""`conform` on nodes that are sound, on nodes with a known defect, and on nodes that must be left alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from command_line import Isocenter
from device_wires import DRIVE_EDS, ENCODER_EDS, VENDOR_FILES, needs_vendor_files
from full_device import NODE, full_device_eds
from mutant_machine import MutantMachine
from node_mutants import Mutant, all_mutants, drawn_mutants

from drivers import bus_url
from drivers.canopen.eds import load_object_dictionary
from drivers.errors import BusUnavailableError
from hil.cli.conformance import conform as conform_command
from hil.conform.all_checks import Conformance, conform
from hil.conform.report import document, lines
from hil.emulated.machine import build_emulated
from hil.errors import UnusableInputError
from hil.machine import load_machine
from virtual_bus.canopen.bare import BareMachine
from virtual_bus.canopen.device_bus import DeviceBus

FILES = sorted(path for path in VENDOR_FILES.glob("*") if path.suffix in (".eds", ".dcf")) if VENDOR_FILES.is_dir() else []
LEAST_CHECKS = 150
FOUND_HERE = 12  # of the drawn mutants; the benchmark tries all
CONTROLWORD = 0x6040
SLICE_S = 0.001
UPLOADS_AND_ABORTS = (2, 3, 4, 5)  # SDO command specifiers of a client that write nothing

pytestmark = pytest.mark.filterwarnings("ignore::drivers.errors.DataSheetWarning")


class TappedBus(DeviceBus):
    """A bus that keeps what the tester sends."""

    def __init__(self, machine: BareMachine) -> None:
        self.sent: list[tuple[int, bytes]] = []
        super().__init__(machine)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append((msg.arbitration_id, bytes(msg.data)))
        super().send(msg, timeout)


class WallBus(DeviceBus):
    """A bus whose tester goes by a clock of its own, whatever the time of the devices is."""

    passed_s = 0.0

    def now(self) -> float:
        return self.passed_s

    def recv(self, timeout: float | None = None) -> can.Message | None:
        end_s = self.passed_s + (timeout or 0.0)
        while not self._frames and self.passed_s < end_s:
            self._machine.idle(SLICE_S)
            self.passed_s += SLICE_S
        return super().recv(0.0)


def checked(machine: BareMachine, eds: Path, *, writes: bool = True, until_failed: bool = False) -> Conformance:
    bus = DeviceBus(machine)
    try:
        dictionary = load_object_dictionary(eds, machine.node.node_id)
        return conform(bus, bus.now, machine.node.node_id, dictionary, writes=writes, until_failed=until_failed)
    finally:
        bus.shutdown()


def failures(found: Conformance) -> list[str]:
    return [f"{result.check}: {result.expected}" for result in found.results if result.result == "fail"]


@pytest.fixture(scope="module")
def full_eds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("eds") / "full.eds"
    path.write_text(full_device_eds())
    return path


@pytest.mark.parametrize("eds", [DRIVE_EDS, ENCODER_EDS], ids=lambda path: path.name)
def test_the_shipped_devices_pass(eds: Path) -> None:
    found = checked(BareMachine(eds, NODE), eds)
    assert failures(found) == []
    assert found.not_restored == ()
    assert found.count("pass") >= LEAST_CHECKS


def test_a_device_with_every_service_passes_and_nothing_is_skipped(full_eds: Path) -> None:
    found = checked(BareMachine(full_eds, NODE), full_eds)
    assert failures(found) == []
    assert [result.reason for result in found.results if result.result == "skip"] == []


@needs_vendor_files
@pytest.mark.parametrize("eds", FILES, ids=lambda path: path.name)
def test_the_bare_device_of_a_vendors_file_passes(eds: Path) -> None:
    node_id = load_object_dictionary(eds).node_id or NODE  # a DCF is one node's
    found = checked(BareMachine(eds, node_id), eds)
    assert failures(found) == []
    assert found.count("pass") >= LEAST_CHECKS


@pytest.mark.parametrize("mutant", drawn_mutants(FOUND_HERE), ids=str)
def test_a_defect_is_found_with_what_was_wrong(mutant: Mutant, full_eds: Path) -> None:
    found = checked(mutant.machine(full_eds, NODE), full_eds, until_failed=True)
    assert found.count("fail") == 1
    failed = next(result for result in found.results if result.result == "fail")
    assert failed.clause.startswith("CiA 30")
    assert failed.expected
    assert failed.frames


def test_the_draw_is_thirty_defects_of_as_many_kinds() -> None:
    drawn = drawn_mutants()
    assert len({mutant.kind for mutant in drawn}) == len(drawn) == 30
    assert [str(mutant) for mutant in drawn] == [str(mutant) for mutant in drawn_mutants()]
    assert {str(mutant) for mutant in drawn} < {str(mutant) for mutant in all_mutants()}


def mutant_of(kind: str, variant: str) -> Mutant:
    return next(mutant for mutant in all_mutants() if (mutant.kind, mutant.variant) == (kind, variant))


def test_a_failure_is_told_in_words_and_as_json(full_eds: Path) -> None:
    mutant = mutant_of("toggle bit of the answer stuck", "download")
    found = checked(mutant.machine(full_eds, NODE), full_eds, writes=False)
    told = "\n".join(lines(found))
    assert "FAIL  SDO, segmented" in told
    assert "[CiA 301, 7.2.4.3.4]" in told
    assert "expected: 30h" in told
    assert "sent 605 1D 03" in told
    assert "came 585 20 00 00 00 00 00 00 00" in told
    answer = json.loads(json.dumps(document(found)))
    assert answer["failed"] == found.count("fail") >= 1
    failed = next(check for check in answer["checks"] if check["result"] == "fail")
    assert {frame["id"] for frame in failed["frames"]} == {0x605, 0x585}
    assert [frame["data"][:2] for frame in failed["frames"]] == ["1D", "20"]


def test_without_writes_no_application_object_is_altered(full_eds: Path) -> None:
    machine = BareMachine(full_eds, NODE)
    altered: list[int] = []
    for entry in machine.node.objects:
        if entry.index >= 0x2000 or entry.index in (0x1010, 0x1011):
            own = entry.value
            machine.node.objects.effects[entry.key] = lambda value, key=entry.key, own=own: altered.append(key) if value != own else None
    found = checked(machine, full_eds, writes=False)
    assert altered == []
    assert failures(found) == []
    assert any("--writes" in result.reason for result in found.results)


def test_a_drive_is_never_commanded() -> None:
    """No download to what a profile lets an RPDO carry, and no RPDO that is mapped to it."""
    machine = BareMachine(DRIVE_EDS, NODE)
    commands = {entry.key for entry in machine.node.objects if entry.index >= 0x6000 and entry.writable and entry.mappable_in_rpdo}
    assert CONTROLWORD << 8 in commands
    bus = TappedBus(machine)
    carried: list[int] = []
    for rpdo in machine.node._rpdos:
        receive = rpdo.receive

        def tapped(data: bytes, rpdo: object = rpdo, receive: Callable[[bytes], None] = receive) -> None:
            carried.extend(entry.key for entry in rpdo._layout.entries)  # type: ignore[attr-defined]
            receive(data)

        rpdo.receive = tapped  # type: ignore[method-assign]
    conform(bus, bus.now, NODE, load_object_dictionary(DRIVE_EDS, NODE), writes=True)
    bus.shutdown()
    downloads = [data for can_id, data in bus.sent if can_id == 0x600 + NODE and data[0] >> 5 not in UPLOADS_AND_ABORTS]
    assert len(downloads) > LEAST_CHECKS
    written = {int.from_bytes(data[1:3], "little") << 8 | data[3] for data in downloads if data[0] >> 5 in (1, 6)}
    assert written & commands == set()
    assert carried, "RPDOs were sent"
    assert set(carried) & commands == set()


def test_what_the_node_held_is_put_back(full_eds: Path) -> None:
    """Settings that were made before, and are not stored, too."""
    machine = BareMachine(full_eds, NODE)
    bus = DeviceBus(machine)
    node = machine.node
    heartbeat, pdo = ("2b 17 10 00 2c 01",), ("23 00 18 01 85 01 00 c0", "2f 00 18 02 05", "23 00 18 01 85 01 00 40")
    for request in (*heartbeat, *pdo, "2f 00 21 00 09"):
        machine.receive(0x600 + NODE, bytes.fromhex(request).ljust(8, b"\0"))
    held = {entry.key: entry.value for entry in node.objects if entry.writable and entry.index != 0x1003}
    found = conform(bus, bus.now, NODE, load_object_dictionary(full_eds, NODE))
    bus.shutdown()
    assert {entry.key: entry.value for entry in node.objects if entry.key in held} == held
    assert found.not_restored == ()
    assert node.objects.number(0x1017) == 300


def test_what_cannot_be_put_back_is_told(full_eds: Path) -> None:
    machine = BareMachine(full_eds, NODE)
    bus = DeviceBus(machine)
    machine.receive(0x600 + NODE, bytes.fromhex("2b 17 10 00 2c 01 00 00"))

    def only_twenty(value: object) -> None:
        if value == 300:
            from virtual_bus.canopen.abort import DEVICE_STATE, SdoAbortError

            raise SdoAbortError(DEVICE_STATE)

    machine.node.objects.checks[0x1017 << 8] = only_twenty
    found = conform(bus, bus.now, NODE, load_object_dictionary(full_eds, NODE))
    bus.shutdown()
    assert found.not_restored == ("1017h:00 held 2C 01",)
    assert "not restored: 1017h:00 held 2C 01" in list(lines(found))


@pytest.mark.parametrize("word", [0x0233, 0x0237, 0x0217])
def test_a_drive_under_voltage_is_left_alone(word: int) -> None:
    machine = BareMachine(DRIVE_EDS, NODE)
    machine.node.objects.readings[0x6041 << 8] = lambda: word
    with pytest.raises(UnusableInputError, match="power stage is on"):
        checked(machine, DRIVE_EDS)
    assert machine.node.state == 0x7F


class SharedBus(DeviceBus):
    """A bus with a second node, of which only an SDO answer is heard."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if msg.arbitration_id == 0x600 + 9:
            self._queue(0x580 + 9, bytes.fromhex("43 00 10 00 00 00 00 00"))
        assert msg.arbitration_id or msg.data[1] == NODE, "an NMT command reaches other nodes"
        assert msg.arbitration_id != 0x080, "a SYNC reaches other nodes"
        super().send(msg, timeout)


def test_nothing_reaches_other_nodes(full_eds: Path) -> None:
    bus = SharedBus(BareMachine(full_eds, NODE))
    found = conform(bus, bus.now, NODE, load_object_dictionary(full_eds, NODE), writes=True)
    bus.shutdown()
    assert found.others == (9,)
    assert failures(found) == []
    assert found.count("pass") >= LEAST_CHECKS
    assert any("other nodes" in result.reason for result in found.results)


def test_a_bus_with_another_master_is_left_alone(full_eds: Path) -> None:
    bus = DeviceBus(BareMachine(full_eds, NODE))
    bus._queue(0x080, b"")
    with pytest.raises(UnusableInputError, match="SYNC"):
        conform(bus, bus.now, NODE, load_object_dictionary(full_eds, NODE))
    bus.shutdown()


def test_the_command_passes_fails_and_refuses(
    isocenter: Isocenter, full_eds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ("conform", "--node", NODE, "--eds", full_eds, "--bus", "lockstep:")
    passed = isocenter(*arguments, "--json", tmp_path / "conform.json")
    assert passed.status == 0
    assert "PASS  object dictionary" in passed.out
    assert json.loads((tmp_path / "conform.json").read_text())["failed"] == 0
    mutant = mutant_of("heartbeat time wrong by a factor", "2")

    def defective(eds: Path, node_id: int) -> MutantMachine:
        return mutant.machine(eds, node_id)

    monkeypatch.setattr("virtual_bus.canopen.bare.BareMachine", defective)
    failed = isocenter(*arguments)
    assert failed.status == 1
    assert "every 20 ms, not 40.0 ms" in failed.out
    assert "failed" in failed.line
    assert isocenter("conform", "--node", 0, "--eds", full_eds, "--bus", "lockstep:").status == 2
    assert isocenter("conform", "--node", 5, "--eds", tmp_path / "none.eds", "--bus", "lockstep:").status == 2
    absent = isocenter("conform", "--node", 5, "--eds", full_eds, "--bus", "virtual:nobody-there")
    assert absent.status == 2
    assert "node 5 does not answer" in absent.line


@pytest.mark.slow
@pytest.mark.parametrize("by_the_wall", [True, False])
def test_timers_of_an_emulated_machine_are_right_only_where_its_time_is_the_walls(by_the_wall: bool) -> None:
    machine = load_machine("carm")
    bus = WallBus(build_emulated(machine, by_the_wall=by_the_wall))  # type: ignore[arg-type]  # receives and idles as a bare device does
    try:
        found = conform(bus, bus.now, 1, load_object_dictionary(DRIVE_EDS, 1), writes=False, until_failed=False)
    finally:
        bus.shutdown()
    assert bool(failures(found)) != by_the_wall


def test_conform_opens_a_stamped_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, bool]] = []

    def refuse(url: str, bitrate: int, **options: bool) -> None:
        asked.append(options)
        raise BusUnavailableError("not here")

    monkeypatch.setattr(bus_url, "open_bus", refuse)
    with pytest.raises(BusUnavailableError):
        conform_command(DRIVE_EDS, "socketcan:can0", 5)
    assert asked == [{"stamped": True}]
