"""Whatever sections of CiA 306 a data sheet has: each is in the object dictionary, or the warning names it."""

from __future__ import annotations

import re
import warnings
from itertools import pairwise

import canopen
import pytest
from canopen.objectdictionary import datatypes
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen.eds import parse_object_dictionary
from drivers.errors import DataSheetWarning

DEVICE_TYPE = "[1000]\nParameterName=Device type\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=0x00030191\n"
VARIABLE = "ParameterName=One\nObjectType=7\nDataType={type}\nAccessType=rw\nPDOMapping=0\n{rest}"
MODULES = """[SupportedModules]
NrOfEntries=3
[M1ModuleInfo]
ProductName=16 digital in
OrderCode=DI16
[M1SubExtends]
NrOfEntries=2
1=0x1027
2=0x6000
[M1SubExt1027]
ParameterName=Module %d
DataType=6
AccessType=ro
DefaultValue=0x0010
Count=1
ObjExtend=0
[M1SubExt6000]
ParameterName=Input bits
DataType=5
AccessType=ro
PDOMapping=1
Count=2
[M2ModuleInfo]
ProductName=8 digital out
[M2SubExtends]
NrOfEntries=1
1=0x1027
[M2SubExt1027]
ParameterName=Module %d
DataType=6
AccessType=ro
DefaultValue=0x0020
Count=1
[M2FixedObjects]
NrOfEntries=1
1=0x2A00
[M2Fixed2A00]
ParameterName=Fault mode
ObjectType=7
DataType=3
AccessType=rw
DefaultValue=-5
[M3ModuleInfo]
ProductName=spare
"""
MODULE_LIST = (
    "[1027]\nParameterName=Module list\nObjectType=8\nSubNumber=1\n[1027sub0]\nParameterName=n\nDataType=5\nAccessType=ro\nDefaultValue=0\n"
)


def parsed(text: str, node_id: int | None = 5) -> tuple[canopen.ObjectDictionary, str]:
    """Return the dictionary and what was said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        dictionary = parse_object_dictionary(text, node_id)
    return dictionary, " ".join(str(one.message) for one in caught if issubclass(one.category, DataSheetWarning))


def test_a_compact_record_has_the_standards_types() -> None:
    text = (
        DEVICE_TYPE
        + "[1800]\nParameterName=TPDO\nObjectType=9\nDataType=0x20\nCompactSubObj=6\n[1800Value]\nNrOfEntries=2\n1=$NODEID+0x180\n2=1\n"
    )
    text += "[1A00]\nParameterName=Map\nObjectType=9\nDataType=0x21\nCompactSubObj=2\n[1A00Value]\n1=0x60000108\n"
    text += "[1200]\nParameterName=SDO\nObjectType=9\nDataType=0x22\nCompactSubObj=3\n"
    text += "[1018]\nParameterName=Identity\nObjectType=9\nDataType=0x23\nCompactSubObj=4\n[1018Value]\n1=0x2F1\n"
    dictionary, said = parsed(text)
    types = {index: [dictionary[index][k].data_type for k in range(1, 1 + many)] for index, many in ((0x1800, 6), (0x1A00, 2), (0x1200, 3))}
    assert types[0x1800] == [
        datatypes.UNSIGNED32, datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED8,
    ]  # fmt: skip
    assert types[0x1A00] == [datatypes.UNSIGNED32] * 2
    assert types[0x1200] == [datatypes.UNSIGNED32, datatypes.UNSIGNED32, datatypes.UNSIGNED8]
    assert [dictionary[0x1800][k].value for k in (1, 2)] == [0x185, 1]
    assert (dictionary[0x1018][1].value, dictionary[0x1A00][1].value, dictionary[0x1A00][0].default) == (0x2F1, 0x60000108, 2)
    assert not said


def test_modules_that_are_not_connected_are_named() -> None:
    dictionary, said = parsed(DEVICE_TYPE + MODULE_LIST + MODULES)
    assert 0x6000 not in dictionary
    assert 0x2A00 not in dictionary
    assert (
        "modules M1 16 digital in, M2 8 digital out, M3 spare described and not connected; [ConnectedModules] of a DCF says which are"
        in said
    )


def test_connected_modules_add_their_objects_in_the_order_of_their_places() -> None:
    dictionary, said = parsed(DEVICE_TYPE + MODULE_LIST + MODULES + "[ConnectedModules]\nNrOfEntries=3\n1=2\n2=1\n3=1\n")
    assert [dictionary[0x1027][k].default for k in range(4)] == [3, 0x20, 0x10, 0x10]
    assert sorted(dictionary[0x6000].subindices) == [0, 1, 2, 3, 4]
    assert (dictionary[0x6000][4].data_type, dictionary[0x6000][4].pdo_mappable) == (datatypes.UNSIGNED8, True)
    assert dictionary[0x2A00].default == -5
    assert "M3 spare described and not connected" in said
    assert "M1" not in said


def test_a_dcf_that_has_the_modules_objects_written_out_gets_them_once() -> None:
    text = DEVICE_TYPE + MODULE_LIST.replace("DefaultValue=0", "DefaultValue=1") + MODULES
    text += "[1027sub1]\nParameterName=Module 1\nDataType=6\nAccessType=ro\nParameterValue=0x20\n[ConnectedModules]\n1=2\n"
    dictionary, said = parsed(text)
    assert sorted(dictionary[0x1027].subindices) == [0, 1]
    assert dictionary[0x1027][1].value == 0x20
    assert "[1027] has 1 subindices: those of the connected modules are taken to be among them" in said


def test_an_array_that_is_full_goes_on_in_the_next_object() -> None:
    text = DEVICE_TYPE + "[M1ModuleInfo]\nProductName=wide\n[M1SubExt6401]\nDataType=3\nAccessType=ro\nCount=200\nObjExtend=0x10\n"
    dictionary, said = parsed(text + "[ConnectedModules]\n1=1\n2=1\n")
    assert (len(dictionary[0x6401].subindices), len(dictionary[0x6411].subindices)) == (255, 147)
    dictionary, said = parsed(text.replace("0x10", "0") + "[ConnectedModules]\n1=1\n2=1\n")
    assert 0x6411 not in dictionary
    assert "[6401] is full: subindices of a module are left out" in said


def test_a_connected_module_without_a_description_is_named() -> None:
    _, said = parsed(DEVICE_TYPE + MODULES + "[ConnectedModules]\n1=7\n2=1\n3=2\n4=3\n")
    assert "module 7 is connected and not described" in said


def test_objects_that_a_module_lists_and_does_not_describe_are_named() -> None:
    text = MODULES.replace("[M1SubExt6000]", "[M1SubExt1]").replace("[M2Fixed2A00]", "[M2Fixed2A01]")
    _, said = parsed(DEVICE_TYPE + MODULES + "[ConnectedModules]\n1=1\n2=2\n")
    assert "without a section" not in said
    dictionary, said = parsed(DEVICE_TYPE + text + "[ConnectedModules]\n1=1\n2=2\n")
    assert 0x6000 not in dictionary
    assert "[M1SubExtends] lists objects without a section: [M1SubExt6000]" in said
    assert "[M2FixedObjects] lists objects without a section: [M2Fixed2A00]" in said
    assert "not taken: [M1SUBEXT1]" in said


def test_the_node_id_of_a_dcf_counts_and_another_is_told() -> None:
    text = (
        DEVICE_TYPE
        + "[1014]\n"
        + VARIABLE.format(type=7, rest="DefaultValue=$NODEID+0x80\n")
        + "[DeviceComissioning]\nNodeID=0x0C\nBaudrate=500\n"
    )
    dictionary, said = parsed(text, None)
    assert (dictionary.node_id, dictionary[0x1014].default, said) == (12, 0x8C, "")
    dictionary, said = parsed(text, 5)
    assert (dictionary.node_id, dictionary[0x1014].default) == (5, 0x85)
    assert "NodeID=12 is this file's, read here for node 5" in said
    _, said = parsed(text.replace("0x0C", "0"), None)
    assert "NodeID=0 is no node id (1 to 127)" in said


SECTIONS = {
    "[FileInfo]": "FileName=a.eds\n",
    "[Comments]": "Lines=1\nLine1=own\n",
    "[DeviceInfo]": "VendorName=Own\nNrOfRXPDO=1\n",
    "[DummyUsage]": "Dummy0001=0\n",
    "[DeviceComissioning]": "NodeID=9\n",
    "[MandatoryObjects]": "SupportedObjects=2\n1=0x1000\n2=0x1001\n",
    "[OptionalObjects]": "SupportedObjects=1\n1=0x1017\n",
    "[ManufacturerObjects]": "SupportedObjects=1\n1=0x2000\n",
    "[1001]": VARIABLE.format(type=5, rest="DefaultValue=3\n"),
    "[1017]": VARIABLE.format(type=6, rest="ParameterValue=150\n"),
    "[1027]": "ParameterName=Modules\nObjectType=8\n",
    "[2000]": VARIABLE.format(type=4, rest="DefaultValue=-7\n"),
    "[2100]": "ParameterName=Many\nObjectType=8\nDataType=3\nAccessType=rw\nCompactSubObj=3\n",
    "[2100Name]": "NrOfEntries=1\n2=middle\n",
    "[2100Value]": "NrOfEntries=1\n3=-30\n",
    "[2100Denotation]": "NrOfEntries=1\n2=of the middle\n",
    "[2200]": "ParameterName=Record\nObjectType=9\nSubNumber=2\n",
    "[2200sub0]": VARIABLE.format(type=5, rest="DefaultValue=1\n"),
    "[2200sub1]": VARIABLE.format(type=8, rest="DefaultValue=0.5\n"),
    "[2300]": "ParameterName=Program\nObjectType=2\nDownloadFile=a.bin\n",
    "[2400]": "ParameterName=Nothing\nObjectType=0\n",
    "[1600ObjectLinks]": "ObjectLinks=1\n1=0x1400\n",
    "[DynamicChannels]": "NrOfSeg=1\nType1=4\n",
    "[Tools]": "Items=1\n",
    "[Tool1]": "Name=Editor\n",
    "[SupportedModules]": "NrOfEntries=1\n",
    "[M1ModuleInfo]": "ProductName=digital in\n",
    "[M1Comments]": "Lines=1\nLine1=own\n",
    "[M1FixedObjects]": "NrOfEntries=1\n1=0x2A00\n",
    "[M1Fixed2A00]": VARIABLE.format(type=3, rest="DefaultValue=-5\n"),
    "[M1SubExtends]": "NrOfEntries=1\n1=0x1027\n",
    "[M1SubExt1027]": "DataType=6\nAccessType=ro\nDefaultValue=0x10\nCount=1\n",
    "[ConnectedModules]": "NrOfEntries=1\n1=1\n",
    "[VendorsOwn]": "a=b\n",
}
"""All sections of CiA 306, and one that it does not have."""

SAYS_NOTHING_OF_OBJECTS = (
    "[FileInfo]",
    "[Comments]",
    "[DeviceInfo]",
    "[DummyUsage]",
    "[MandatoryObjects]",
    "[OptionalObjects]",
    "[ManufacturerObjects]",
)


def is_taken(head: str, names: set[str], dictionary: canopen.ObjectDictionary) -> bool:
    """Return whether what a section says is in the dictionary."""
    value = re.search(r"(?:Default|Parameter)Value=(\S+)", SECTIONS[head])
    match head:
        case "[DeviceComissioning]":
            return bool(dictionary.node_id == 9)
        case "[2100]":
            return [dictionary[0x2100][k].data_type for k in (1, 2, 3)] == [3, 3, 3]
        case "[2100Name]":
            return "[2100]" in names and bool(dictionary[0x2100][2].name == "middle")
        case "[2100Value]":
            return "[2100]" in names and bool(dictionary[0x2100][3].value == -30)
        case "[2200]" | "[1027]":
            return int(head[1:5], 16) in dictionary
        case "[2200sub0]" | "[2200sub1]":
            return bool(dictionary[0x2200][int(head[8])].default == float(value[1])) if value else False
        case _ if re.fullmatch(r"\[\d{4}\]", head) and value:
            found = dictionary[int(head[1:5], 16)]
            return float(found.value if "ParameterValue" in SECTIONS[head] else found.default) == float(value[1])
        case _ if head.startswith("[M1") or head.endswith("Modules]"):
            connected = {"[ConnectedModules]"} <= names and any(name.startswith("[M1") for name in names)
            added = ("[M1Fixed2A00]" not in names or dictionary[0x2A00].default == -5) if connected else False
            return connected and added and ("[M1SubExt1027]" not in names or dictionary[0x1027][1].default == 0x10)
    return False


@settings(max_examples=examples(150), deadline=None)
@given(names=st.sets(st.sampled_from(sorted(SECTIONS))), shuffled=st.randoms(use_true_random=False))
def test_any_subset_of_the_sections_is_taken_or_listed(names: set[str], shuffled: object) -> None:
    heads = sorted(names)
    shuffled.shuffle(heads)  # type: ignore[attr-defined]
    dictionary, said = parsed(DEVICE_TYPE + "".join(f"{head}\n{SECTIONS[head]}" for head in heads), None)
    lines = re.findall(r"lines? ([\d, ]+)", said)
    for head in names:
        if head in SAYS_NOTHING_OF_OBJECTS or is_taken(head, names, dictionary):
            continue
        if head.startswith("[M1") or head.endswith("Modules]"):
            assert "not connected" in said or "not described" in said or not any(name.startswith("[M1") for name in names), (head, said)
        elif head in ("[2300]", "[2400]"):
            assert "DownloadFile was not taken" in said if head == "[2300]" else "ObjectType=0 holds no value" in said
        else:
            assert "not taken" in said, (head, said)
            assert head.upper() in said.upper() or "..." in said, (head, said, lines)
    for listing, head in (("[M1SubExtends]", "[M1SubExt1027]"), ("[M1FixedObjects]", "[M1Fixed2A00]")):
        lacking = {"[ConnectedModules]", listing} <= names and head not in names
        assert (f"{listing} lists objects without a section: {head}" in said) == lacking


@pytest.mark.parametrize("missing", ["0x1001", "0x2000"])
def test_an_object_that_is_listed_and_has_no_section_is_named(missing: str) -> None:
    _, said = parsed(DEVICE_TYPE + f"[OptionalObjects]\nSupportedObjects=1\n1={missing}\n")
    assert f"listed without a section, and so not there: [{missing[2:]}]" in said


def test_sections_come_in_any_order_and_case() -> None:
    text = DEVICE_TYPE + MODULE_LIST + MODULES + "[ConnectedModules]\nNrOfEntries=1\n1=1\n"
    parts = re.findall(r"\[[^\[]+", text)
    orders = [parts, parts[::-1], [part.upper().replace("0X", "0x") for part in parts]]
    found = [
        {index: sorted(dictionary[index].subindices) for index in (0x1027, 0x6000)} for dictionary, _ in map(parsed, map("".join, orders))
    ]
    assert all(first == second for first, second in pairwise(found))
