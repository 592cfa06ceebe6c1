"""Nothing of a data sheet is dropped unsaid: keys, lines, elements, whole PDOs; what cannot be read is refused in one line."""

from __future__ import annotations

import warnings
from pathlib import Path

import canopen
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import answer_or_refusal

from drivers.canopen.eds import load_object_dictionary, parse_object_dictionary
from drivers.errors import DataSheetWarning, ProtocolError

DEVICE_TYPE = "[1000]\nParameterName=Device type\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=0x00030191\n"
SHEET = DEVICE_TYPE + "[2000]\nParameterName=One\nObjectType=7\nDataType=4\nAccessType=rw\nPDOMapping=0\nDefaultValue=-7\n"


def parsed(text: str, node_id: int | None = 5) -> tuple[canopen.ObjectDictionary, str]:
    """Return the dictionary and what was said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        dictionary = parse_object_dictionary(text, node_id)
    return dictionary, " ".join(str(one.message) for one in caught if issubclass(one.category, DataSheetWarning))


def content(dictionary: canopen.ObjectDictionary) -> list[tuple[object, ...]]:
    """Everything of a dictionary that a section can say."""
    found = []
    for index, entry in dictionary.items():
        for one in entry.values() if hasattr(entry, "values") else [entry]:
            found.append((index, one.subindex, one.name, one.data_type, one.access_type, one.pdo_mappable, one.default, one.value))
            found.append((index, one.subindex, one.min, one.max, one.storage_location))
    return found


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("ObjFlags=2\n", "line 14: ObjFlags was not taken"),
        ("Denotation=mine\nParamRefd=x\n", "lines 14, 15: Denotation, ParamRefd were not taken"),
        ("DefaltValue=9\n", "line 14: DefaltValue was not taken"),
        ("DefaultValue -9\n", "line 14: a line that is no section and no key of one was left out"),
        ("DefaultValue=-8\n", "line 14: a key that stands twice in its section has the last value"),
        ("[2001]\n[2000]\nLowLimit=-9\n[2001]\nDataType=5\n", "lines 15, 17: a section that stands twice is read as one"),
        ("[DeviceComissioning]\nNodeName=roll\nNetNumber=3\nNodeRefd=\n", "lines 15, 16: NodeName, NetNumber were not taken"),
        ("[DeviceComissioning]\nBaudrate=fast\n", "line 15: Baudrate=fast is no number and was left out"),
        ("[2100]\nObjectType=9\nSubNumber=3\n[2100sub0]\nDataType=5\n", "line 16: [2100] says 3 subindices, 1 are described"),
        (
            "[2100]\nObjectType=8\nDataType=3\nCompactSubObj=2\n[2100Value]\n3=1\n",
            "line 19: [2100] has 2 elements: a value or name of another",
        ),
    ],
)
def test_what_is_not_taken_is_told_with_its_line(text: str, words: str) -> None:
    assert words in parsed(SHEET + text)[1]


@pytest.mark.parametrize("text", ["ObjFlags=0x0\n", "Denotation=\n", "DefaultValue=-7\n", "; a comment\n", "LowLimit=-9\n"])
def test_nothing_is_said_where_nothing_is_lost(text: str) -> None:
    assert parsed(SHEET + text)[1] == ""


@settings(max_examples=examples(200), deadline=None, derandomize=True)
@given(
    at=st.integers(1, SHEET.count("\n")),
    line=st.text(st.characters(min_codepoint=32, max_codepoint=255, exclude_characters="[;#\x7f\x85"), min_size=1, max_size=20)
    | st.builds(
        "{}={}".format, st.sampled_from(("ObjFlags", "DefaultValue", "Unit", "LowLimit", "ParameterName")), st.text("019x-a", max_size=4)
    ),
)
def test_a_line_more_is_taken_told_or_refused(at: int, line: str) -> None:
    lines = SHEET.splitlines()
    lines.insert(at, line)
    answer, refusal = answer_or_refusal(ProtocolError, parsed, "\n".join(lines))
    if refusal is not None:
        assert "\n" not in refusal
        return
    dictionary, said = answer
    key, equals, value = (part.strip() for part in line.partition("="))
    empty = not line.strip() or (equals and not value.strip("0x")) or f"{key}={value}" in SHEET
    assert said or empty or content(dictionary) != content(parsed(SHEET)[0]), line


@settings(max_examples=examples(60), deadline=None, derandomize=True)
@given(at=st.integers(0, len(SHEET) - 1), inserted=st.binary(min_size=1, max_size=6))
def test_any_damage_gives_one_line(tmp_path_factory: pytest.TempPathFactory, at: int, inserted: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.eds"
    raw = SHEET.encode()
    path.write_bytes(raw[:at] + inserted + raw[at:])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        _, refusal = answer_or_refusal(ProtocolError, load_object_dictionary, path, 5)
    assert "\n" not in (refusal or "")
    assert len(caught) <= 1
    assert all("\n" not in str(one.message) for one in caught)


def test_pdos_of_a_compact_description_are_those_of_cia_301() -> None:
    info = "[DeviceInfo]\nGranularity=8\nNrOfRXPDO=1\nNrOfTXPDO=6\nCompactPDO=0x13\n"
    own = "[1801]\nObjectType=9\n[1801sub0]\nDataType=5\nDefaultValue=2\n[1801sub1]\nDataType=7\nDefaultValue=0x333\n"
    dictionary, said = parsed(DEVICE_TYPE + info + own)
    assert dictionary[0x1400][1].default == 0x205
    assert [dictionary[index][1].default for index in range(0x1800, 0x1806)] == [0x185, 0x333, 0x385, 0x485, 0x80000000, 0x80000000]
    assert sorted(dictionary[0x1803]) == [0, 1, 2, 5]
    assert [dictionary[0x1803][sub].data_type for sub in (1, 2, 5)] == [7, 5, 6]
    assert sorted(dictionary[0x1A03]) == list(range(9))
    assert dictionary[0x1A03][8].data_type == 7
    assert "NrOfTXPDO=6 with CompactPDO: 1800h to 1805h not described, read as CiA 301's, nothing mapped" in said
    assert "NrOfRXPDO=1 with CompactPDO: 1400h not described" in said


def test_nothing_is_added_without_a_compact_description() -> None:
    dictionary, said = parsed(DEVICE_TYPE + "[DeviceInfo]\nGranularity=8\nNrOfRXPDO=4\nNrOfTXPDO=4\nCompactPDO=0\n")
    assert (list(dictionary), said) == ([0x1000], "")


def test_a_count_of_pdos_beyond_the_standard_does_not_fill_the_memory() -> None:
    with pytest.raises(ProtocolError, match="a data sheet has at most"):
        parsed(DEVICE_TYPE + "[DeviceInfo]\nGranularity=1\nNrOfRXPDO=99999999\nNrOfTXPDO=512\nCompactPDO=0xFF\n")


@pytest.mark.parametrize(
    ("data_type", "text", "value"),
    [
        (0x08, "0.75", 0.75),
        (0x08, "0x3F400000", 0.75),
        (0x11, "0xBFE8000000000000", -0.75),
        (0x0A, "0x01 0x02", b"\1\2"),
        (0x0A, "01 fe", b"\1\xfe"),
        (0x09, "two words", "two words"),
    ],
)
def test_values_of_other_types(data_type: int, text: str, value: object) -> None:
    dictionary, said = parsed(SHEET + f"[2001]\nDataType={data_type}\nDefaultValue={text}\n")
    assert (dictionary[0x2001].default, said) == (value, "")


@pytest.mark.parametrize(("data_type", "text"), [(0x08, "fast"), (0x08, "0x3F40000000"), (0x0A, "no bytes"), (0x0F, "program.bin")])
def test_a_value_that_is_none_of_its_type_is_told(data_type: int, text: str) -> None:
    dictionary, said = parsed(SHEET + f"[2001]\nDataType={data_type}\nDefaultValue={text}\n")
    assert dictionary[0x2001].default is None
    assert f"line 16: DefaultValue is no value of type {data_type:04X}h and was left out" in said


def test_the_bit_rate_of_a_dcf_is_read() -> None:
    dictionary, said = parsed(SHEET + "[DeviceComissioning]\nNodeID=5\nBaudrate=250\n")
    assert (dictionary.bitrate, said) == (250_000, "")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "cp1252"])
def test_a_file_of_any_windows_encoding_is_the_same(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "a.eds").write_bytes(SHEET.replace("One", "Größe").encode(encoding))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dictionary = load_object_dictionary(tmp_path / "a.eds", 5)
    assert (dictionary[0x2000].name, dictionary[0x1000].default) == ("Größe", 0x00030191)


def test_a_description_in_xml_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.xdd").write_text('<?xml version="1.0"?>\n<ISO15745ProfileContainer/>\n')
    with pytest.raises(ProtocolError, match=r"a\.xdd: begins with <, as XML does \(XDD and XDC of CiA 311\); read are EDS and DCF"):
        load_object_dictionary(tmp_path / "a.xdd", 5)
