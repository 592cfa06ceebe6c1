"""Device files as vendors write them, and broken ones."""

from __future__ import annotations

import configparser
import re
from pathlib import Path

import canopen
import pytest
from device_wires import DRIVE_EDS, ENCODER_EDS, VENDOR_FILES, needs_vendor_files
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import answer_or_refusal

from drivers.canopen.eds import load_object_dictionary, parse_object_dictionary
from drivers.errors import DataSheetWarning, ProtocolError

VENDOR_NAMES = (
    "canopennode_DS301_profile.eds",
    "kacanopen_cia406.eds",
    "maxon_EPOS4_compact_50-8_node1.eds",
    "maxon_epos4_50_8_can_encoder_node1.dcf",
    "pilz_prbt_0_1.dcf",
    "ros2_canopen_fake_cia402_slave.eds",
)
SMALLEST = "[1000]\nParameterName=Device type\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=0x00020192\n"


def variable(dictionary: canopen.ObjectDictionary, index: int, subindex: int = 0) -> canopen.objectdictionary.ODVariable:
    return dictionary.get_variable(index, subindex)


@needs_vendor_files
@pytest.mark.parametrize("name", VENDOR_NAMES)
def test_every_object_of_a_vendors_file_is_there_with_its_type(name: str) -> None:
    text = (VENDOR_FILES / name).read_bytes().decode("cp1252")
    raw = configparser.RawConfigParser(strict=False, inline_comment_prefixes=(";",))
    raw.read_string(text[text.index("[") :])
    dictionary = load_object_dictionary(VENDOR_FILES / name, 5)
    checked = 0
    for section in raw.sections():
        match = re.fullmatch(r"([0-9A-Fa-f]{4})(?:[sS]ub([0-9A-Fa-f]+))?", section)
        is_variable = int(raw[section].get("objecttype", "7"), 0) == 7 if match else False
        if match and is_variable and raw[section].get("datatype"):
            found = variable(dictionary, int(match.group(1), 16), int(match.group(2) or "0", 16))
            assert found.data_type == int(raw[section]["datatype"], 0), section
            assert found.access_type == raw[section]["accesstype"].lower(), section
            checked += 1
    assert checked > 60


@needs_vendor_files
@pytest.mark.parametrize(
    ("name", "index", "subindex", "default"),
    [
        ("canopennode_DS301_profile.eds", 0x1800, 1, 0xC0000180 + 5),
        ("canopennode_DS301_profile.eds", 0x1014, 0, 0x85),
        ("maxon_EPOS4_compact_50-8_node1.eds", 0x1400, 1, 0x205),
        ("maxon_EPOS4_compact_50-8_node1.eds", 0x6076, 0, None),
        ("kacanopen_cia406.eds", 0x1800, 1, 0x185),
    ],
)
def test_defaults_take_the_node_id(name: str, index: int, subindex: int, default: int | None) -> None:
    found = variable(load_object_dictionary(VENDOR_FILES / name, 5), index, subindex).default
    if default is None:
        assert isinstance(found, int)
    else:
        assert found == default


@needs_vendor_files
def test_a_dcf_brings_its_configured_values_and_its_own_node_id() -> None:
    dictionary = load_object_dictionary(VENDOR_FILES / "maxon_epos4_50_8_can_encoder_node1.dcf")
    assert dictionary.node_id == 1
    assert any(variable(dictionary, 0x1A00, sub).value for sub in range(1, 4))


@pytest.mark.parametrize("path", [DRIVE_EDS, ENCODER_EDS])
def test_our_own_files_read_the_same_without_any_repair(path: Path) -> None:
    plain, ours = canopen.import_od(str(path), 3), load_object_dictionary(path, 3)
    assert list(plain) == list(ours)
    for index in plain:
        for found in plain[index].values() if hasattr(plain[index], "values") else [plain[index]]:
            same = variable(ours, index, found.subindex)
            assert (same.default, same.data_type, same.access_type, same.pdo_mappable) == (
                (found.default, found.data_type, found.access_type, found.pdo_mappable)
            )


@pytest.mark.parametrize(
    ("line", "type_", "value"),
    [
        ("DefaultValue=0xFFFF", 3, -1),  # a negative INTEGER16 written as unsigned hex
        ("DefaultValue=-5", 3, -5),
        ("DefaultValue=017", 5, 15),  # octal, CiA 306
        ("DefaultValue=09", 5, 9),
        ("DefaultValue=0x10 ; sixteen", 5, 16),
        ("defaultvalue=$NODEID+0x180", 7, 0x185),
        ("DefaultValue=0x40000000+$NODEID+0x180", 7, 0x40000185),
        ("DefaultValue=", 5, None),
        ("DefaultValue=TRUE", 1, 1),
    ],
)
def test_values_are_read_as_the_standard_and_the_vendors_write_them(line: str, type_: int, value: int | None) -> None:
    text = f"{SMALLEST}[2000]\nPARAMETERNAME=x\nDataType={type_:#x}\nAccessType=RW\n{line}\n"
    assert variable(parse_object_dictionary(text, 5), 0x2000).default == value


@pytest.mark.parametrize(("own", "basic"), [("[A0sub1]\nDefaultValue=0x0006\n", 6), ("", 0xF)])
def test_a_type_of_the_files_own_is_its_basic_type(own: str, basic: int) -> None:
    text = f"{SMALLEST}[2000]\nParameterName=x\nDataType=0x00A0\nAccessType=rw\nDefaultValue=1\n{own}"
    assert variable(parse_object_dictionary(text, 5), 0x2000).data_type == basic


def test_a_compact_array_has_all_its_elements() -> None:
    array = "[2100]\nParameterName=a\nObjectType=8\nDataType=6\nAccessType=rw\nDefaultValue=7\nCompactSubObj=3\n[2100Value]\n2=9\n"
    text = SMALLEST + array
    dictionary = parse_object_dictionary(text, 5)
    assert [variable(dictionary, 0x2100, sub).default for sub in range(4)] == [3, 7, 7, 7]
    assert variable(dictionary, 0x2100, 2).value == 9


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no object from 1000h on"),
        ("[1000\nDataType=7\n", "section head without ]"),
        (SMALLEST + "[2000]\nAccessType=rw\n", "[2000]: DataType is missing"),
        (SMALLEST + "[2000]\nDataType=5\nAccessType=maybe\n", "AccessType=maybe: must be one of"),
        (SMALLEST + "[2000]\nDataType=5\nDefaultValue=300\n", "does not fit into 8 bits"),
        (SMALLEST + "[2000]\nDataType=five\n", "must be an integer"),
    ],
)
def test_a_broken_file_is_named_in_one_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "broken.eds"
    path.write_text(text)
    with pytest.raises(ProtocolError) as refused:
        load_object_dictionary(path, 5)
    assert str(refused.value).startswith(str(path))
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("bent", "index", "subindex", "value", "says"),
    [
        ("[2000sub1]\nDataType=5\nDefaultValue=7\n", 0x2000, 1, 7, "line 7: object [2000] is missing; its subindices are read as a record"),
        ("[2000]\nDataType=0x5 # UNSIGNED8\nDefaultValue=7 # seven\n", 0x2000, 0, 7, "lines 8, 9: a comment behind a value begins with ;"),
        ("[2000]\nDataType=5\nAccessType=rw // both\nDefaultValue=7\n", 0x2000, 0, 7, "line 9: a comment behind a value"),
        ("[2000]\nDataType=7\nDefaultValue=0x7UL\n", 0x2000, 0, 7, "line 9: a suffix as of C behind a number was left out"),
        ("[2000]\nDataType=0x1B\nDefaultValue=7LL\n", 0x2000, 0, 7, "line 9: a suffix as of C"),
        (
            "[2000]\nDataType=6\nHighLimit=65536\nDefaultValue=7\n",
            0x2000,
            0,
            7,
            "line 9: HighLimit=65536 is beyond its type and read as 65535",
        ),
        (
            "[2000]\nDataType=3\nLowLimit=-32769\nDefaultValue=7\n",
            0x2000,
            0,
            7,
            "line 9: LowLimit=-32769 is beyond its type and read as -32768",
        ),
        (
            "[1017]\nDataType=0xF\nDefaultValue=7\n",
            0x1017,
            0,
            7,
            "line 8: DataType=0xF of a communication object is read as CiA 301's 0006h",
        ),
        ("[2000]\nDataType=7\nDefaultValue=0000 0080h\n", 0x2000, 0, 0x80, "line 9: a hexadecimal number begins with 0x"),
        ("[2000]\nDataType=7\nDefaultValue=each\n", 0x2000, 0, None, "line 9: a default that is no number was left out"),
        ("[2000]\nDataType=5\nDefaultValue=of the profile\n", 0x2000, 0, None, "line 9: a default that is no number was left out"),
    ],
)
def test_a_file_that_bends_the_rules_is_read_and_tells_line_and_repair(
    bent: str, index: int, subindex: int, value: int | None, says: str
) -> None:
    with pytest.warns(DataSheetWarning) as told:
        found = variable(parse_object_dictionary(SMALLEST + bent, 5, "bent.eds"), index, subindex)
    assert found.default == value
    (warning,) = told
    assert str(warning.message).startswith(f"bent.eds: {says}")


@pytest.mark.parametrize("written", ["$NODEID", "$NodeId", "$nodeid", "NODEID", "$NODE_ID", "${NODEID}", "$NodeID "])
def test_the_node_id_is_found_in_every_spelling(written: str) -> None:
    for value in (f"{written}+0x180", f"0x180 + {written}"):
        text = f"{SMALLEST}[2000]\nDataType=7\nDefaultValue={value}\n"
        assert variable(parse_object_dictionary(text, 5), 0x2000).default == 0x185


def test_lines_of_one_kind_of_repair_are_told_together() -> None:
    objects = "".join(f"[{index:X}]\nDataType=5 # U8\n" for index in range(0x2000, 0x2010))
    with pytest.warns(DataSheetWarning, match=r"^EDS: lines 8, 10, 12 and 13 more: a comment behind a value begins with ;") as told:
        parse_object_dictionary(SMALLEST + objects, 5)
    assert len(told) == 1


def test_a_missing_file_is_named() -> None:
    with pytest.raises(ProtocolError, match=r"nowhere\.eds: cannot be read"):
        load_object_dictionary("nowhere.eds", 5)


_ORIGINAL = ENCODER_EDS.read_bytes()


@settings(max_examples=examples(60), deadline=None, derandomize=True)
@given(data=st.data())
def test_a_corrupted_file_loads_or_is_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    raw = bytearray(_ORIGINAL)
    for _ in range(data.draw(st.integers(1, 12))):
        at = data.draw(st.integers(0, len(raw) - 2))
        how = data.draw(st.sampled_from(["byte", "cut", "double", "swap"]))
        if how == "byte":
            raw[at] = data.draw(st.integers(0, 255))
        elif how == "cut":
            del raw[at : at + data.draw(st.integers(1, 40))]
        elif how == "double":
            raw[at:at] = raw[at : at + 60]
        else:
            raw[at], raw[at + 1] = raw[at + 1], raw[at]
        raw = raw if len(raw) > 2 else bytearray(_ORIGINAL)
    path = tmp_path_factory.getbasetemp() / "corrupted.eds"
    path.write_bytes(bytes(raw))
    dictionary, refusal = answer_or_refusal(ProtocolError, load_object_dictionary, path, 5)
    assert isinstance(dictionary, canopen.ObjectDictionary) if refusal is None else "\n" not in refusal
