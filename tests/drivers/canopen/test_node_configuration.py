"""Nodes set up from a machine file: the CiA 301 mapping procedure byte by byte, identity, scaling, and real vendors' data sheets."""

from __future__ import annotations

import dataclasses
import math
import struct
from pathlib import Path

import canopen
import pytest
from places import DATA
from scripted_nodes import EDS, BusClock, ScriptedBus, ScriptedDrive, ScriptedEncoder, machine_settings

from drivers.canopen.cia406 import check_alarms, signed_counts
from drivers.canopen.configuration import configure_node, configure_pdo
from drivers.canopen.eds import load_object_dictionary
from drivers.canopen.identity import check_identity
from drivers.canopen.network import PolledNetwork
from drivers.canopen.sdo import SdoNode
from drivers.errors import ConfigurationRefusedError, DeviceFaultError, WrongIdentityError
from drivers.settings import AxisScaling, BusSettings, Identity, Node, Pdo

VENDOR_FILES = DATA / "canopen"


def opened(node: ScriptedDrive | ScriptedEncoder, settings_node: Node, eds: Path | None = None) -> tuple[ScriptedBus, SdoNode]:
    bus = ScriptedBus(node)
    dictionary = load_object_dictionary(eds or settings_node.eds, settings_node.node_id)
    return bus, SdoNode(PolledNetwork(bus, BusClock(bus)), settings_node.node_id, settings_node.name, dictionary)


def configured(
    node: ScriptedDrive, k: int = 0, settings: BusSettings | None = None, **changes: tuple[tuple[int, int, int], tuple[int, int, int]]
) -> tuple[ScriptedBus, tuple[str, ...]]:
    settings = settings or machine_settings()
    wanted = dataclasses.replace(settings.nodes[k], **changes)
    bus, sdo = opened(node, wanted)
    scaling = settings.scalings[k] if wanted.role == "drive" else None
    return bus, configure_node(sdo, wanted, settings, scaling)


def writes(bus: ScriptedBus, request: int = 0x601) -> list[tuple[int, int, int]]:
    """(index, subindex, value) of every expedited download, in order."""
    found = []
    for data in bus.sent(request):
        if data[0] & 0xE0 == 0x20:
            index, subindex = struct.unpack_from("<HB", data, 1)
            found.append((index, subindex, int.from_bytes(data[4 : 8 - (data[0] >> 2 & 3)], "little")))
    return found


def test_a_pdo_is_mapped_by_the_standards_procedure_and_order() -> None:
    settings = machine_settings()
    bus, sdo = opened(ScriptedDrive(1), settings.nodes[0])
    configure_pdo(sdo, settings.nodes[0].tpdos[0], transmit=True)
    assert writes(bus) == [
        (0x1800, 1, 0xC000_0181),  # invalid
        (0x1A00, 0, 0),
        (0x1A00, 1, 0x6041_0010),
        (0x1A00, 2, 0x6064_0020),
        (0x1A00, 3, 0x6078_0010),
        (0x1A00, 0, 3),
        (0x1800, 2, 1),
        (0x1800, 1, 0x4000_0181),  # valid, no RTR
    ]


def test_every_write_is_read_back() -> None:
    bus, _ = configured(ScriptedDrive(1))
    requests = [(data[0] & 0xE0, struct.unpack_from("<HB", data, 1)) for data in bus.sent(0x601)]
    for position, (kind, key) in enumerate(requests):
        if kind == 0x20:
            assert requests[position + 1] == (0x40, key)


def test_a_configured_drive_has_pdos_heartbeats_option_codes_and_limits() -> None:
    drive = ScriptedDrive(1)
    drive.set(0x1801, 1, 0x4000_0281)  # a PDO that nobody asked for is on
    _, notes = configured(drive)
    assert drive.value(0x1801, 1) >> 31 == 1
    assert [drive.value(0x1400, 1), drive.value(0x1400, 2)] == [0x201, 1]
    assert [drive.value(0x1600, s) for s in range(3)] == [2, 0x6040_0010, 0x6071_0010]
    assert drive.value(0x1017) == 100
    assert drive.value(0x1016, 1) == 127 << 16 | 250  # the bench may be silent for two and a half of its periods
    assert [drive.value(index) for index in (0x6007, 0x605A, 0x605C, 0x605E)] == [3, 6, 1, 2]
    assert [drive.value(0x6075), drive.value(0x6076)] == [5000, 675]
    assert [drive.value(0x6072), drive.value(0x6073)] == [1600, 1600]  # 8 A of 5 A rated
    assert notes == ()


def test_targets_and_offsets_that_no_pdo_carries_are_zero() -> None:
    drive = ScriptedDrive(1)
    drive.objects |= {(0x60B0, 0): bytes(4), (0x60B1, 0): bytes(4), (0x60B2, 0): bytes(2)}
    for index in (0x60B1, 0x60B2, 0x6071):
        drive.set(index, 0, 300)  # of somebody before
    bus, _ = configured(drive)
    assert [drive.value(index) for index in (0x60B0, 0x60B1, 0x60B2)] == [0, 0, 0]
    assert drive.value(0x6071) == 300  # comes with every SYNC
    assert [w for w in writes(bus) if w[0] == 0x60B2] == [(0x60B2, 0, 0)]


@pytest.mark.parametrize(
    ("rate_Hz", "wanted", "told"), [(256.0, (39, -4), False), (250.0, (4, -3), False), (7.9, (127, -3), False), (3.45, (29, -2), False)]
)
def test_the_interpolation_time_is_as_near_to_the_period_as_it_comes(rate_Hz: float, wanted: tuple[int, int], told: bool) -> None:
    drive = ScriptedDrive(1)
    drive.objects |= {(0x60C2, 0): b"\x02", (0x60C2, 1): bytes(1), (0x60C2, 2): bytes(1)}
    settings = machine_settings()
    scalings = tuple(dataclasses.replace(scaling, mode="position") for scaling in settings.scalings)
    _, notes = configured(drive, settings=dataclasses.replace(settings, sync_period_s=1.0 / rate_Hz, scalings=scalings))
    assert (drive.value(0x60C2, 1), drive.value(0x60C2, 2) - 256) == wanted
    assert any("60C2h" in note for note in notes) == told


def test_the_sync_identifier_is_set_where_it_differs() -> None:
    drive = ScriptedDrive(1)
    _, _ = configured(drive, settings=dataclasses.replace(machine_settings(), sync_cob_id=0x0A0))
    assert drive.value(0x1005) == 0x0A0


def test_the_machine_files_own_writes_come_last_and_win() -> None:
    drive = ScriptedDrive(1)
    bus, _ = configured(drive, writes=((0x6007, 0, 3), (0x6072, 0, 900)))
    assert (drive.value(0x6007), drive.value(0x6072)) == (3, 900)
    assert [w for w in writes(bus) if w[0] in (0x6007, 0x6072)] == [(0x6007, 0, 3), (0x6072, 0, 900)]


def test_what_an_earlier_master_has_left_to_be_added_to_the_commands_is_set_to_zero() -> None:
    drive = ScriptedDrive(1)
    drive.objects |= {(index, 0): bytes(4 if index < 0x60B2 else 2) for index in (0x60B0, 0x60B1, 0x60B2)}
    for index in (0x60B0, 0x60B1, 0x60B2):
        drive.set(index, 0, 300)
    drive.set(0x6071, 0, 200)  # the RPDO overwrites it with every SYNC
    configured(drive)
    assert [drive.value(index) for index in (0x60B0, 0x60B1, 0x60B2, 0x6071)] == [0, 0, 0, 200]
    wanted = machine_settings().nodes[0].rpdos[0]
    offset_mapped = dataclasses.replace(wanted, entries=((0x6040, 0, 16), (0x60B2, 0, 16)))
    configured(drive, rpdos=(offset_mapped,))
    assert drive.value(0x6071) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "what"),
    [((0x1800, 1), "1800h:01"), ((0x1A00, 2), "1A00h:02"), ((0x1017, 0), "1017h"), ((0x6007, 0), "6007h"), ((0x1016, 1), "1016h:01")],
)
@pytest.mark.parametrize("kind", ["abort", "stuck"])
def test_a_refused_or_forgotten_setting_names_node_and_object(place: tuple[int, int], what: str, kind: str) -> None:
    drive = ScriptedDrive(1)
    if kind == "abort":
        drive.aborts[place] = 0x06090030
    else:
        drive.stuck.add(place)
    with pytest.raises(ConfigurationRefusedError, match=r"propeller_drive \(node 1\)") as caught:
        configured(drive)
    assert what in str(caught.value)


def test_a_rated_current_that_differs_and_cannot_be_set_says_how_wrong_efforts_would_be() -> None:
    drive = ScriptedDrive(1)
    drive.set(0x6075, 0, 4000)
    drive.aborts[0x6075, 0] = 0x06010002
    with pytest.raises(ConfigurationRefusedError, match=r"rated current in mA \(6075h\) is 4000, the machine file says 5000; .* -20\.0%"):
        configured(drive)


def test_a_drive_that_cannot_watch_the_bench_is_refused_unless_the_file_says_what_stops_it() -> None:
    settings = dataclasses.replace(machine_settings(), master_heartbeat_period_s=0.0)
    with pytest.raises(ConfigurationRefusedError, match=r"no heartbeat consumer \(1016h\).*stopped_by = "):
        configured(ScriptedDrive(1), settings=settings)
    first, *others = settings.nodes
    named = dataclasses.replace(settings, nodes=(dataclasses.replace(first, stopped_by="safe torque off in the door's chain"), *others))
    _, notes = configured(ScriptedDrive(1), settings=named)
    assert len(notes) == 1
    assert notes[0].endswith("what stops it, by the machine file: safe torque off in the door's chain")


def test_a_fixed_mapping_is_compared_instead_of_written() -> None:
    settings = machine_settings()
    drive = ScriptedDrive(1)
    drive.objects |= {(0x1A00, 0): b"\x01", (0x1A00, 1): struct.pack("<I", 0x6041_0010)}
    dictionary = load_object_dictionary(EDS / "isocenter_drive.eds", 1)
    dictionary[0x1A00][0].access_type = "ro"
    bus = ScriptedBus(drive)
    sdo = SdoNode(PolledNetwork(bus, BusClock(bus)), 1, "fixed", dictionary)
    configure_pdo(sdo, Pdo(1, 0x181, 1, ((0x6041, 0, 16),)), transmit=True)
    with pytest.raises(ConfigurationRefusedError, match=r"fixed to 6041h:00/16, the machine file wants 6064h:00/32"):
        configure_pdo(sdo, Pdo(1, 0x181, 1, ((0x6064, 0, 32),)), transmit=True)
    assert settings.nodes[0].name == "propeller_drive"


@pytest.mark.parametrize(
    ("subindex", "value", "words"),
    [(1, 0xFB, "vendor_id is 000000FBh, the machine file says 00000000h"), (2, 1, "product_code"), (3, 0x20000, "revision_number")],
)
def test_a_wrong_identity_names_expected_and_found(subindex: int, value: int, words: str) -> None:
    drive = ScriptedDrive(1)
    drive.set(0x1018, subindex, value)
    node = machine_settings().nodes[0]
    _, sdo = opened(drive, node)
    with pytest.raises(WrongIdentityError, match=words):
        check_identity(sdo, node)


def test_identity_fields_the_machine_file_leaves_open_are_not_compared() -> None:
    drive = ScriptedDrive(1)
    drive.set(0x1018, 1, 0xFB)
    node = dataclasses.replace(machine_settings().nodes[0], identity=Identity(None, 0x49534F01, None, None))
    check_identity(opened(drive, node)[1], node)


def test_an_encoder_where_a_drive_is_expected_is_a_wrong_identity() -> None:
    node = machine_settings().nodes[0]
    _, sdo = opened(ScriptedEncoder(1, ScriptedDrive(2)), node)
    with pytest.raises(WrongIdentityError, match=r"found encoder \(CiA 406\), the machine file expects drive"):
        check_identity(sdo, node)


def test_an_encoder_with_an_alarm_is_refused() -> None:
    encoder = ScriptedEncoder(11, ScriptedDrive(1))
    node = machine_settings().nodes[2]
    _, sdo = opened(encoder, node)
    check_alarms(sdo)
    encoder.set(0x6503, 0, 0x1001)
    with pytest.raises(DeviceFaultError, match="position error, manufacturer's alarm 12"):
        check_alarms(sdo)


@pytest.mark.parametrize(("raw", "zero", "counts"), [(5, 3, 2), (3, 5, -2), (0xFFFF_FFFF, 1, -2), (1, 0xFFFF_FFFF, 2), (-1, 1, -2)])
def test_encoder_counts_are_signed_across_the_end_of_the_counter(raw: int, zero: int, counts: int) -> None:
    assert signed_counts(raw, zero) == counts


class VendorDrive(ScriptedDrive):
    """Has exactly the objects of a vendor's data sheet, with its defaults, and refuses writes to what the sheet calls read only."""

    def __init__(self, dictionary: canopen.ObjectDictionary, node_id: int) -> None:
        super().__init__(node_id)
        self.dictionary = dictionary
        self.objects = {}
        for entry in dictionary.values():
            for variable in [entry] if isinstance(entry, canopen.objectdictionary.ODVariable) else entry.values():
                size = len(variable) // 8 if variable.fixed_size else 4
                default = variable.default if isinstance(variable.default, int) else 0
                self.objects[variable.index, variable.subindex] = (default & (1 << 8 * size) - 1).to_bytes(size, "little")
        for number in range(512):
            for base in (0x1400, 0x1800):
                self.objects.setdefault((base + number, 1), b"\0\0\0\x80")

    def refuse(self, index: int, subindex: int, value: bytes) -> int:
        variable = self.dictionary.get_variable(index, subindex)
        if not variable.writable:
            return 0x06010002
        if len(value) != len(self.objects[index, subindex]):
            return 0x06070010
        return super().refuse(index, subindex, value)


@pytest.mark.parametrize("name", ["maxon_EPOS4_compact_50-8_node1.eds", "maxon_epos4_50_8_can_encoder_node1.dcf", "pilz_prbt_0_1.dcf"])
def test_a_real_vendors_drive_is_configured_from_its_own_data_sheet(name: str) -> None:
    path = VENDOR_FILES / name
    if not path.exists():
        pytest.skip(f"real device files are not here: {path}")
    dictionary = load_object_dictionary(path, 1)
    if dictionary.get_variable(0x6071) is None or dictionary.get_variable(0x6078) is None:
        entries = ((0x6041, 0, 16), (0x6064, 0, 32))
        targets = ((0x6040, 0, 16),)
    else:
        entries, targets = ((0x6041, 0, 16), (0x6064, 0, 32), (0x6077, 0, 16)), ((0x6040, 0, 16), (0x6071, 0, 16))
    node = Node(
        "vendor", "drive", "roll", 1, path, Identity(*[None] * 4), (Pdo(1, 0x181, 1, entries),), (Pdo(1, 0x201, 1, targets),), 0.1, 2.0
    )
    lacks = any(dictionary.get_variable(index) is None for index in (0x1016, 0x6007, 0x605E))
    node = dataclasses.replace(node, stopped_by="safe torque off" if lacks else "")
    drive = VendorDrive(dictionary, 1)
    bus = ScriptedBus(drive)
    sdo = SdoNode(PolledNetwork(bus, BusClock(bus)), 1, "vendor", dictionary)
    scaling = AxisScaling("roll", 1e-5, 0.0, 0, 1, 5.0, 8.0, 0, 0, counts_per_motor_turn=4096.0)
    notes = configure_node(sdo, node, machine_settings(), scaling)
    assert [drive.value(0x1A00, s) for s in range(len(entries) + 1)] == [len(entries), *(i << 16 | s << 8 | b for i, s, b in entries)]
    assert drive.value(0x1800, 1) == 0x4000_0181
    assert drive.value(0x1017) == 100
    assert len(notes) == lacks


RPM_PER_S, MILLI_RPM_PER_S = 0x00C00300, 0xFDC00300
RAMP = 600.0 * math.pi / 180.0  # rad/s^2 of the quick stop
MOTOR_TURN = 2.0 * math.pi / 150.0  # rad at the joint, of the scripted drives' gear


def stopped(stored: int, sheet: int = RPM_PER_S, **changes: object) -> tuple[list[tuple[int, int, int]], tuple[str, ...]]:
    """What is written to a drive in torque mode that has this unit of acceleration stored, and what is told."""
    settings = machine_settings()
    motions = (dataclasses.replace(settings.motions[0], quick_stop=RAMP), *settings.motions[1:])
    settings, node = dataclasses.replace(settings, motions=motions), dataclasses.replace(settings.nodes[0], **changes)
    drive = ScriptedDrive(1)
    drive.objects |= {(0x6085, 0): bytes(4), (0x60A9, 0): struct.pack("<I", 0x00010300), (0x60AA, 0): struct.pack("<I", stored)}
    bus, sdo = opened(drive, node)
    for index, unit in ((0x60A9, 0x00010300), (0x60AA, sheet)):  # velocities are in a unit that says nothing of the counts
        variable = canopen.objectdictionary.ODVariable("unit", index)
        variable.data_type, variable.default = canopen.objectdictionary.UNSIGNED32, unit
        sdo.dictionary.add_object(variable)
    scaling = dataclasses.replace(settings.scalings[0], counts_per_motor_turn=4096.0)
    notes = configure_node(sdo, node, settings, scaling)
    return writes(bus), notes


def test_the_quick_stop_of_a_drive_in_torque_mode_is_in_a_unit_that_it_has() -> None:
    written, _ = stopped(RPM_PER_S)
    assert (0x6085, 0, round(RAMP / MOTOR_TURN * 60.0)) in written
    with pytest.raises(ConfigurationRefusedError, match=r"unit of acceleration.*off by 1000"):
        stopped(MILLI_RPM_PER_S)
    with pytest.raises(ConfigurationRefusedError, match="unit of acceleration"):
        stopped(MILLI_RPM_PER_S, writes=((0x6085, 0, 15_000),))


def test_a_unit_that_the_machine_file_writes_is_the_drives_before_anything_is_written_in_it() -> None:
    written, _ = stopped(RPM_PER_S, writes=((0x60AA, 0, MILLI_RPM_PER_S),))
    ramp = (0x6085, 0, round(RAMP / MOTOR_TURN * 60e3))
    assert written.index((0x60AA, 0, MILLI_RPM_PER_S)) < written.index(ramp)
    assert [entry[0] for entry in written].count(0x60AA) == 1
