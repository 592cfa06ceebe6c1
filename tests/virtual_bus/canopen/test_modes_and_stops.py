"""What all modes of operation share: numbers, changes, stops, halts, faults, and promises that no sequence of commands breaks."""

from __future__ import annotations

import struct

import canopen
import pytest
from device_wires import DRIVE_EDS, PERIOD_S, RESOLUTION, Wire, abort_code, client, drive_settings
from drive_master import Answer, DriveMaster
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_bus.canopen.drive import Cia402Drive
from virtual_bus.errors import EmulatorError

NONE, PP, PV, HOMING, CSP, CSV, CST = 0, 1, 3, 6, 8, 9, 10
MOVING_MODES = (PP, PV, CSP, CSV, CST)
SWITCH_ON_DISABLED, SWITCHED_ON, OPERATION_ENABLED, QUICK_STOP_ACTIVE, FAULT_REACTION, FAULT = 0x40, 0x23, 0x27, 0x07, 0x0F, 0x08
ENABLED, HALT = 0x0F, 1 << 8
TARGET_REACHED = 1 << 10
LIMIT = 1600  # per mille, of the test's drive


def bench() -> tuple[Wire, canopen.RemoteNode, Cia402Drive]:
    wire = Wire()
    drive = Cia402Drive(drive_settings(node_id=4), PERIOD_S, lambda can_id, data: None)
    wire.attach(drive)
    return wire, client(wire, DRIVE_EDS), drive


# ---- which modes ---------------------------------------------------------------------------------------


def test_6502h_says_which_modes_6060h_takes_and_no_other() -> None:
    _, remote, _ = bench()
    bits = {PP: 0, 2: 1, PV: 2, 4: 3, HOMING: 5, 7: 6, CSP: 7, CSV: 8, CST: 9, 11: 10}  # IEC 61800-7-201, object 6502h
    supported = int(remote.sdo[0x6502].raw)
    for mode in range(-128, 128):
        if mode == NONE or (mode in bits and supported >> bits[mode] & 1):
            remote.sdo[0x6060].raw = mode
            assert remote.sdo[0x6061].raw == mode
        else:
            before = remote.sdo[0x6061].raw
            assert abort_code(lambda mode=mode: remote.sdo.download(0x6060, 0, struct.pack("<b", mode))) == 0x06090030
            assert remote.sdo[0x6061].raw == remote.sdo[0x6060].raw == before
    assert supported == sum(1 << bits[mode] for mode in (*MOVING_MODES, HOMING))


def test_a_mode_that_a_pdo_asks_for_and_the_drive_has_not_changes_nothing() -> None:
    master = DriveMaster(mode=CST)
    master.switch_on()
    assert master.step(torque=100).torque == 100
    for unknown in (2, 4, 7, 11, -1):
        answer = master.step(mode=unknown)
        assert (answer.mode, answer.torque) == (CST, 100)
    assert master.step(mode=CSV).mode == CSV


def test_a_device_whose_data_sheet_lacks_a_modes_objects_does_not_offer_it(tmp_path: object) -> None:
    text = DRIVE_EDS.read_text().replace("[60FF]", "[5FFF]")
    eds = tmp_path / "without_target_velocity.eds"  # type: ignore[operator]
    eds.write_text(text)
    wire = Wire()
    wire.attach(Cia402Drive(drive_settings(node_id=4, eds=eds), PERIOD_S, lambda can_id, data: None))
    remote = client(wire, eds)
    assert remote.sdo[0x6502].raw == 0x3A5 & ~(1 << 8 | 1 << 2)
    assert abort_code(lambda: remote.sdo.download(0x6060, 0, b"\x09")) == 0x06090030
    assert abort_code(lambda: remote.sdo.download(0x6060, 0, b"\x03")) == 0x06090030


def test_a_data_sheet_whose_target_is_no_integer_is_refused(tmp_path: object) -> None:
    before, of_target, behind = DRIVE_EDS.read_text().partition("[6071]")
    eds = tmp_path / "real_target_torque.eds"  # type: ignore[operator]
    eds.write_text(before + of_target + behind.replace("DataType=0x0003", "DataType=0x0008", 1))  # REAL32
    with pytest.raises(EmulatorError, match="6071h is no integer"):
        Cia402Drive(drive_settings(node_id=4, eds=eds), PERIOD_S, lambda can_id, data: None)


@pytest.mark.parametrize("before", MOVING_MODES)
@pytest.mark.parametrize("after", [*MOVING_MODES, HOMING])
def test_a_change_of_mode_in_motion_takes_over_at_the_present_torque(before: int, after: int) -> None:
    """Targets match the motion, so what is left is the ramp of a mode that slows: 1.25 rad/s^2 * 20 A s/rad / 256 Hz = 20 per mille."""
    master, _ = moving(CSV)
    master.physics.load[0] = 0.75
    now = master.steps(400, torque_offset=50)
    for mode in (before, after):
        speed = master.get(0x606C, signed=True)
        ahead = speed if mode == CSP else 0
        taken = master.step(mode=mode, torque=now.torque - 50, velocity=speed, position=now.position, velocity_offset=ahead)
        assert taken.mode == mode
        assert taken.torque == pytest.approx(now.torque, abs=2 if mode in (CSP, CSV, CST) else 25)
        now = taken
    assert abs(now.torque) > 100, "there was something to keep"


@pytest.mark.parametrize("option", [0, 1])
@pytest.mark.parametrize("how", ["fault", "quick stop", "disable", "reboot", "mode"])
def test_what_has_ended_a_set_point_has_forgotten_it(how: str, option: int) -> None:
    master, _ = moving(PP)
    drive = master.machine.drives["roll_drive"]
    for index in (0x605A, 0x605B, 0x605C, 0x605E):
        master.set(index, option, "<h")
    if how == "fault":
        drive.inject_fault(0x2310)
        master.steps(600, word=0x00)
        master.step(word=0x80)
    elif how == "quick stop":
        master.steps(600, word=0x02)
    elif how == "disable":
        master.steps(600, word=0x07)
        master.step(word=ENABLED)
    elif how == "reboot":
        drive.power_on(master.machine.time_s)
        master.again().asked.mode = CST
    if how != "disable":
        master.switch_on(velocity=0, mode=PP if how in ("fault", "quick stop") else CSV)
    at = master.steps(800, mode=PP).position
    assert abs(master.steps(100).position - at) < 500, "a set-point would lead it on by 15 000 counts"


# ---- stops in every mode -------------------------------------------------------------------------------


def moving(mode: int, speed: float = 0.6) -> tuple[DriveMaster, Answer]:
    """A drive that turns at about this speed [rad/s] by the mode's own means."""
    master = DriveMaster(mode=mode)
    counts_s = round(speed / RESOLUTION)
    for index, value in ((0x6081, counts_s), (0x6083, round(2.0 / RESOLUTION)), (0x6084, round(1.25 / RESOLUTION))):
        master.set(index, value)
    master.set(0x6085, round(2.5 / RESOLUTION))
    answer = master.switch_on()
    if mode == PP:
        answer = master.step(word=ENABLED | 1 << 4, position=10**9)
        answer = master.steps(300, word=ENABLED)
    elif mode == CSP:
        for k in range(500):
            answer = master.step(position=round(k * PERIOD_S * counts_s), velocity_offset=counts_s)
    elif mode == CST:
        answer = master.steps(round(speed / 2.0 / PERIOD_S), torque=400)
    else:
        answer = master.steps(300, velocity=counts_s)
    assert master.physics.speed[0] == pytest.approx(speed, rel=0.05)
    return master, answer


def slows_down(master: DriveMaster, deceleration: float, word: int) -> Answer:
    """Send a controlword and watch: the motor slows down at this rate [rad/s^2] to standstill."""
    before, began = float(master.physics.speed[0]), 0
    while abs(master.physics.speed[0]) > 0.1 * before:
        answer = master.step(word=word)
        began += 1
        assert began < 2000
    assert began * PERIOD_S == pytest.approx(0.9 * before / deceleration, rel=0.25)
    answer = master.steps(400)
    assert abs(master.physics.speed[0]) < 0.01
    return answer


@pytest.mark.parametrize("mode", MOVING_MODES)
@pytest.mark.parametrize(("option", "deceleration", "ends"), [(1, 1.25, SWITCH_ON_DISABLED), (6, 2.5, QUICK_STOP_ACTIVE)])
def test_a_quick_stop_works_in_every_mode(mode: int, option: int, deceleration: float, ends: int) -> None:
    master, _ = moving(mode)
    master.set(0x605A, option, "<h")
    assert slows_down(master, deceleration, 0x02).state == ends
    if ends == QUICK_STOP_ACTIVE:
        answer = master.steps(3, word=ENABLED, torque=0, velocity=0, velocity_offset=0, position=master.step().position)
        assert answer.state == OPERATION_ENABLED
        assert abs(answer.torque) < 200, "it goes on from standstill"


@pytest.mark.parametrize("mode", MOVING_MODES)
@pytest.mark.parametrize(("option", "deceleration"), [(1, 1.25), (2, 2.5)])
def test_a_halt_works_in_every_mode(mode: int, option: int, deceleration: float) -> None:
    master, _ = moving(mode)
    master.set(0x605D, option, "<h")
    answer = slows_down(master, deceleration, ENABLED | HALT)
    assert answer.state == OPERATION_ENABLED
    assert answer.statusword & TARGET_REACHED


@pytest.mark.parametrize("mode", MOVING_MODES)
@pytest.mark.parametrize(("index", "word", "ends"), [(0x605C, 0x07, SWITCHED_ON), (0x605B, 0x06, 0x21)])
def test_disabling_slows_down_or_coasts_as_its_option_says(mode: int, index: int, word: int, ends: int) -> None:
    master, _ = moving(mode)
    master.set(index, 1, "<h")
    assert slows_down(master, 1.25, word).state == ends
    master, _ = moving(mode)
    master.set(index, 0, "<h")
    answer = master.step(word=word)
    assert (answer.state, answer.torque) == (ends, 0)


@pytest.mark.parametrize("mode", MOVING_MODES)
@pytest.mark.parametrize(("option", "deceleration"), [(1, 1.25), (2, 2.5), (0, None)])
def test_a_fault_stops_every_mode_as_605eh_says(mode: int, option: int, deceleration: float | None) -> None:
    master, _ = moving(mode)
    master.set(0x605E, option, "<h")
    master.machine.drives["roll_drive"].inject_fault(0x2310)
    if deceleration is None:
        answer = master.step()
        assert (answer.state, answer.torque) == (FAULT, 0)
    else:
        assert slows_down(master, deceleration, ENABLED).state == FAULT
    master.step(word=0x00)
    assert master.step(word=0x80).state == SWITCH_ON_DISABLED


@pytest.mark.parametrize("mode", [*MOVING_MODES, HOMING])
def test_a_halt_from_before_the_enabling_begins_at_no_torque(mode: int) -> None:
    """What a stop has left in the velocity loop is not there the next time."""
    master, _ = moving(CST)
    master.physics.load[0] = 2.0
    master.steps(800, word=ENABLED | HALT)
    assert master.step().torque == pytest.approx(400, abs=30), "it holds the load"
    master.steps(3, word=0x00)
    master.physics.load[0] = 0.0
    master.physics.speed[0] = 0.0
    master.steps(20, mode=mode, torque=0, velocity=0, velocity_offset=0)
    for word in (0x06, 0x07, ENABLED | HALT):
        answer = master.step(word=word)
    assert answer.state == OPERATION_ENABLED
    assert abs(answer.torque) < 20


def test_a_homing_does_not_start_in_a_halt() -> None:
    attained = 1 << 12
    master = DriveMaster(mode=HOMING)  # method 37: home is where it stands
    master.switch_on()
    for word, home in ((ENABLED | HALT, False), (ENABLED | HALT | 1 << 4, False), (ENABLED, False), (ENABLED | 1 << 4, True)):
        assert bool(master.steps(3, word=word).statusword & attained) is home


def test_a_homing_that_a_halt_has_ended_does_not_go_on_after_it() -> None:
    master = DriveMaster(position=0.3, mode=HOMING, negative_switch=-5.0)
    master.set(0x6098, 17, "<b")
    master.switch_on()
    master.steps(200, word=ENABLED | 1 << 4)
    at = master.steps(400, word=ENABLED | HALT | 1 << 4).position
    assert at < -500, "it was on its way"
    assert master.steps(300, word=ENABLED | 1 << 4).position == pytest.approx(at, abs=50)


# ---- any sequence --------------------------------------------------------------------------------------

WORDS = (0x00, 0x02, 0x06, 0x07, 0x0F, 0x0F, 0x0F, 0x0F, 0x1F, 0x2F, 0x3F, 0x5F, 0x7F, 0x80, 0x10F, 0x11F)
moves = st.fixed_dictionaries(
    {},
    optional={
        "word": st.sampled_from(WORDS),
        "mode": st.sampled_from([NONE, PP, PV, HOMING, CSP, CSV, CST, 2, 4, -1]),
        "torque": st.integers(-32768, 32767),
        "position": st.one_of(st.integers(-50_000, 50_000), st.integers(-(2**31), 2**31 - 1)),
        "velocity": st.one_of(st.integers(-50_000, 50_000), st.integers(-(2**31), 2**31 - 1)),
        "position_offset": st.one_of(st.just(0), st.integers(-(2**31), 2**31 - 1)),
        "velocity_offset": st.one_of(st.just(0), st.integers(-(2**31), 2**31 - 1)),
        "torque_offset": st.one_of(st.just(0), st.integers(-32768, 32767)),
    },
)
events = st.sampled_from([None, None, None, None, None, "fault", "limit", "load", "option"])


@settings(max_examples=examples(60), deadline=None, derandomize=True)
@given(plan=st.lists(st.tuples(moves, st.integers(1, 12), events, st.integers(0, 8)), min_size=3, max_size=25))
def test_no_sequence_of_commands_breaks_a_promise(plan: list[tuple[dict[str, int], int, str | None, int]]) -> None:
    master = DriveMaster()
    drive = master.machine.drives["roll_drive"]
    limit, mode = LIMIT, NONE
    for changes, count, event, number in plan:
        if event == "fault":
            drive.inject_fault(0x2310)
        elif event == "limit":
            limit = 100 * (number + 1)
            master.set(0x6072, limit, "<H")
        elif event == "load":
            master.physics.load[0] = number - 4.0
        elif event == "option":
            master.set(0x605A, number, "<h")
        for _ in range(count):
            answer = master.step(**changes)
            asked = master.asked.mode
            mode = asked if asked in (NONE, *MOVING_MODES, HOMING) else mode
            assert answer.mode == mode, "the display is the mode that acts"
            assert abs(answer.torque) <= limit
            assert master.physics.effort[0] == pytest.approx(answer.torque * 0.005)
            if answer.state not in (OPERATION_ENABLED, QUICK_STOP_ACTIVE, FAULT_REACTION):
                assert answer.torque == 0
                assert not master.physics.speed[0], "the brake holds what nobody drives"


# ---- an independent master -----------------------------------------------------------------------------


@pytest.mark.parametrize(("mode", "name", "index"), [(PV, "PROFILED VELOCITY", 0x60FF), (PP, "PROFILED POSITION", 0x607A)])
def test_the_canopen_librarys_own_profile_commands_a_set_point(mode: int, name: str, index: int) -> None:
    """`BaseNode402` reads 6502h, changes the mode, walks the automaton and sets the target, all over SDO."""
    from canopen.profiles.p402 import BaseNode402

    wire, _, drive = bench()
    place, speed, send = [0.0, 0.0], [0.0], wire.send_message

    def sample(count: int) -> None:
        for _ in range(count):
            wire.now_s += PERIOD_S
            drive.tick(wire.now_s)
            speed[0] += PERIOD_S * drive.command()  # 1 A accelerates by 1 rad/s^2
            place[0] += PERIOD_S * speed[0]
            drive.latch(round(place[0] / RESOLUTION), 0.0, 24.0)

    def send_and_let_time_pass(can_id: int, data: bytes, remote: bool = False) -> None:
        send(can_id, data, remote)
        sample(1)

    wire.send_message = send_and_let_time_pass  # type: ignore[method-assign]
    node = BaseNode402(4, str(DRIVE_EDS))
    wire.add_node(node)
    assert node.is_op_mode_supported(name)
    node.op_mode = name
    assert node.op_mode == name
    node.state = "OPERATION ENABLED"
    assert node.state == "OPERATION ENABLED"
    node.sdo[index].raw = 20_000
    if mode == PP:
        node.controlword = 0x1F
        assert node.statusword & 1 << 12
        node.controlword = 0x0F
    sample(1500)
    assert node.statusword & TARGET_REACHED
    shown = node.sdo[0x6064 if mode == PP else 0x606C].raw
    assert shown == pytest.approx(20_000, abs=100 if mode == PP else 500)
