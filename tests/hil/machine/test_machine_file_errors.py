"""A wrong machine file gets one line: file, key, value, what is wrong, what would be right."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil.errors import MachineFileError
from hil.files.toml_text import toml_text
from hil.machine import Machine, load_machine, machine_from_text
from hil.machine.load import parse_toml

CARM = load_machine("carm").text
FAST = settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)

# what is replaced (first occurrence), by what, and words the line must have
ROLL_ENCODER = CARM[CARM.index("[bus.nodes.roll_encoder]") : CARM.index("[bus.homing.propeller]")]
MISTAKES = [
    ("[timing]", "[timing", ["no valid TOML", "line 8"]),
    ("format = 1", "format = 2", ["format = 2", "must be 1"]),
    ("mass_kg = 120.0", "mass_kg = -1.0", ["body.ceiling_mount.mass_kg = -1.0", "must not be negative"]),
    ("mass_kg = 120.0", 'mass_kg = "heavy"', ["body.ceiling_mount.mass_kg", "must be a number"]),
    ("mass_kg = 120.0", "mass_kg = nan", ["must be a finite number"]),
    ("mass_kg = 120.0", "mass_kg = true", ["body.ceiling_mount.mass_kg = true", "must be a number"]),
    ("mass_kg = 120.0", "mass_g = true", ["body.ceiling_mount.mass_g = true", "must be a number"]),
    ("mass_kg = 120.0", "", ["body.ceiling_mount.mass_kg", "is missing"]),
    ("mass_kg = 120.0", "mass_lb = 120.0", ["unknown unit lb", "mass_kg or mass_g"]),
    ("mass_kg = 120.0", "mass = 120.0", ["needs its unit", "mass_kg"]),
    ("mass_kg = 120.0", "mas_kg = 120.0", ["unknown key", "did you mean mass_kg?"]),
    ("mass_kg = 120.0", "mass_kg = 120.0\nmass_g = 1.0", ["mass_g", "says the same as mass_kg"]),
    ('name = "sleeve"', 'name = "support_arm"', ["body.support_arm.name", "two bodies"]),
    ('parent = "sleeve"', 'parent = "sleev"', ['parent = "sleev"', "no such body", "sleeve"]),
    ('parent = "world"', 'parent = "detector"', ["listed below its child"]),
    ("axis = [0.0, 0.0, 1.0]", "axis = [0.0, 0.0, 2.0]", ["joint.axis", "must have 1", "[0, 0, 1]"]),
    ("axis = [0.0, 0.0, 1.0]", "axis = [0.0, 0.0, 0.0]", ["has length 0"]),
    ("axis = [0.0, 0.0, 1.0]", "axis = [0.0, 1.0]", ["joint.axis", "too short"]),
    ("[27.0, 44.0, 22.0, 0.0, 0.0, 0.0]", "[27.0, 144.0, 22.0, 0.0, 0.0, 0.0]", ["inertia_kg_m2", "triangle inequality"]),
    ("[27.0, 44.0, 22.0, 0.0, 0.0, 0.0]", "[27.0, 44.0, 22.0, 40.0, 0.0, 0.0]", ["not positive definite"]),
    ("inertia_kg_m2 = [27.0, 44.0, 22.0, 0.0, 0.0, 0.0]", "", ["body.c_arc.inertia_kg_m2", "a body that turns needs an inertia"]),
    ("stiffness_Nm_rad", "stiffness_N_m", ["stiffness_N_m", "does not fit a revolute joint", "stiffness_Nm_rad"]),
    ('type = "revolute"', 'type = "ball"', ['type = "ball"', "'revolute' or 'prismatic'"]),
    ("substeps = 4", "substeps = 4.5", ["timing.substeps = 4.5", "whole number"]),
    ('"latch", "advance"]', '"advance", "latch"]', ["timing.sync_order"]),
    ('joint = "roll"', 'joint = "rol"', ['drives.roll.joint = "rol"', "no such joint", "roll_gear"]),
    ('joint = "roll"', 'joint = "propeller"', ["drives.roll.joint", "already driven", "one drive with the sum of their constants"]),
    ("rated_current_A = 5.0", "rated_current_A = -3.0", ["drives.propeller.rated_current_A = -3.0", "must be positive"]),
    ("rated_current_A = 5.0", "", ["drives.propeller.target_resolution_permille", "add rated_current_A"]),
    ("limit_A = 8.0", "limit_V = 8.0", ["drives.propeller.limit_V", "write limit_A"]),
    ('constant_unit = "Nm/A"', 'constant_unit = "Nm/V"', ["constant_unit", "effort_unit A"]),
    ('constant_unit = "Nm/A"', 'constant_unit = "N/A"', ["a force cannot drive the revolute joint"]),
    ("ratio = 500.0", "ratio = 1" + 400 * "0", ["drives.propeller.ratio", "must be a number"]),
    ("ratio = 500.0", "ratio = 1" + 5000 * "0", ["no valid TOML", "too many digits"]),
    ('joints = ["roll", "roll_gear"]', 'joints = ["roll_gear"]', ["sensors.link_position_roll.joints", "roll", "whose command is 0"]),
    ("[sensors.position_roll]", "[sensors.positon_roll]", ["sensors.positon_roll", "position_roll"]),
    ("[sensors.current_roll]", "[sensors.effort_roll]", ["sensors.effort_roll", "must be called current_roll"]),
    ('body = "detector"', 'body = "detecter"', ["sensors.imu.body", "no such body"]),
    ("rise_K_per_A2", "rise_K_per_V2", ["rise_K_per_V2", "rise_K_per_A2"]),
    ("[controller.roll]", "[controller.yaw]", ["controller.yaw", "no such axis"]),
    ("0.0, 1.0, -1.0, 0.0]", "0.0, 2.0, -1.0, 0.0]", ["controller.propeller.position_sections[0]", "fourth number must be 1"]),
    ("range_deg = [-95.0, 95.0]", "range_deg = [90.0, -90.0]", ["limits.roll.range_deg", "lower end must be below"]),
    ("range_deg = [-95.0, 95.0]", "range_mm = [-90.0, 90.0]", ["limits.roll.range_mm", "angular unit"]),
    ('source_body = "tube"', 'source_body = "lamp"', ["geometry.source_body", "no such body"]),
    ("answer_timeout_s = 0.0025", "answer_timeout_ms = 4.0", ["bus.answer_timeout_ms", "shorter than the sample period"]),
    ("node_id = 2", "node_id = 1", ["bus.nodes.roll_drive.node_id = 1", "propeller_drive", "must differ"]),
    ("node_id = 2", "node_id = 127", ["bus.nodes.roll_drive.node_id = 127", "the bench"]),
    ("node_id = 2", "node_id = 128", ["must be at most 127"]),
    ("cob_id = 0x182", "cob_id = 0x181", ["0x181 already belongs to propeller_drive TPDO1"]),
    ("cob_id = 0x182", "cob_id = 0x080", ["already belongs to SYNC"]),
    ("cob_id = 0x182", "cob_id = 0x582", ["0x582 belongs to SDO"]),
    ('"position_actual_value", "current', '"position_actual_value", "position_value", "current', ["holds 12 bytes", "a PDO holds 8"]),
    ('"position_actual_value", "current', '"position_actal_value", "current', ["tpdo[0].map[1]", "no such object"]),
    ('map = ["statusword", "position_actual_value", "current_actual_value"]', 'map = ["statusword"]', ["position_actual_value", "TPDO"]),
    ('axis = "roll"\nnode_id = 2', 'axis = "propeller"\nnode_id = 2', ["already has the drive propeller_drive"]),
    ("brake_coils = { propeller = 0, roll = 1 }", "brake_coils = { propeller = 0, roll = 0 }", ["bus.io.brake_coils", "share an address"]),
    ("[bus.homing.roll]", "[bus.homing.yaw]", ["bus.homing.yaw", "no such axis"]),
    ("[limits.roll]", '[limits."ro\\nll"]', ["limits", "must be a name"]),
    (ROLL_ENCODER, "", ["bus.homing.roll.method = 37", "takes the present position as zero", "add a link encoder or choose a method"]),
]


@pytest.mark.parametrize(("old", "new", "words"), MISTAKES, ids=[f"{i}-{' '.join(m[2])[:40]}" for i, m in enumerate(MISTAKES)])
def test_a_mistake_gets_one_line_that_names_it(old: str, new: str, words: list[str]) -> None:
    assert old in CARM
    with pytest.raises(MachineFileError) as caught:
        machine_from_text(CARM.replace(old, new, 1), label="carm.toml")
    line = str(caught.value)
    assert line.startswith("carm.toml: ")
    assert "\n" not in line
    assert len(line) < 400
    for word in words:
        assert word in line


def test_a_missing_file_names_what_is_shipped(tmp_path: Path) -> None:
    with pytest.raises(
        MachineFileError, match=r"nothing\.toml: No such file.*carm, carm-csp, carm-csv, carm-real, coupled_electric_drives, emps"
    ):
        load_machine(tmp_path / "nothing.toml")


def test_a_folder_or_bytes_are_no_machine_file(tmp_path: Path) -> None:
    with pytest.raises(MachineFileError, match="directory"):
        load_machine(tmp_path)
    (tmp_path / "latin.toml").write_bytes("name = 'Röntgen'".encode("latin-1"))
    with pytest.raises(MachineFileError, match="byte 9 is no UTF-8"):
        load_machine(tmp_path / "latin.toml")


def outcome(text: str) -> Machine | str:
    """A machine, or the one line; anything else fails the test."""
    try:
        return machine_from_text(text, label="carm.toml")
    except MachineFileError as error:
        line = str(error)
        assert line.startswith("carm.toml: ")
        assert "\n" not in line
        assert len(line) < 600
        return line


@FAST
@given(data=st.data())
def test_damaged_text_gives_a_machine_or_one_line(data: st.DataObject) -> None:
    text = CARM
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        stop = min(len(text), start + data.draw(st.integers(0, 30)))
        text = text[:start] + data.draw(st.text(max_size=5)) + text[stop:]
    assert isinstance(outcome(text), Machine | str)


def leaves(
    table: dict[str, object] | list[dict[str, object] | float | str], path: tuple[int | str, ...] = ()
) -> Iterator[tuple[int | str, ...]]:
    """Paths to every value, tables and lists included."""
    entries = table.items() if isinstance(table, dict) else enumerate(table)
    for key, value in entries:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from leaves(value, (*path, key))


LEAVES = sorted(leaves(parse_toml(CARM, "carm.toml")), key=str)
VALUES = st.one_of(
    st.floats(),
    st.integers(-(10**30), 10**30),
    st.booleans(),
    st.text(max_size=8),
    st.lists(st.one_of(st.floats(), st.integers(-5, 5), st.text(max_size=3)), max_size=7),
    st.dictionaries(st.text(max_size=4), st.integers(0, 3), max_size=2),
)


@pytest.mark.slow
@FAST
@given(where=st.sampled_from(LEAVES), value=VALUES, drop=st.booleans())
def test_any_value_in_any_place_gives_a_machine_or_one_line(where: tuple[int | str, ...], value: object, drop: bool) -> None:
    raw = parse_toml(CARM, "carm.toml")
    table = raw
    for key in where[:-1]:
        table = table[key]
    if drop:
        del table[where[-1]]
    else:
        table[where[-1]] = value
    assert isinstance(outcome(toml_text(raw)), Machine | str)


def test_a_rewritten_file_says_the_same() -> None:
    again = machine_from_text(toml_text(parse_toml(CARM, "carm.toml")))
    original = machine_from_text(CARM)
    assert again.bus == original.bus
    assert again.limits == original.limits
    assert [joint.stiffness for joint in again.plant.tree.joints] == [joint.stiffness for joint in original.plant.tree.joints]
