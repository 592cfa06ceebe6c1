"""Data sheets of the kinds that people bring, which lie beside the repository: read as their notes say, and what is not is said."""

from __future__ import annotations

import canopen
import pytest
from places import DATA, needs_data

from drivers.canopen.eds import load_object_dictionary, own_node_id
from drivers.errors import DataSheetWarning

FIELD = DATA / "field"
pytestmark = needs_data("field", "inputs as people bring them are")


def read(name: str, node_id: int | None, words: str) -> canopen.ObjectDictionary:
    with pytest.warns(DataSheetWarning, match=words):
        return load_object_dictionary(FIELD / name, node_id)


def test_a_coupler_s_compact_records_are_read_and_its_modules_named() -> None:
    dictionary = read("31b-eds-compact-record/coupler.eds", 6, "M1 16 digital in, M2 8 digital out described and not connected")
    assert [dictionary[0x1800][k].value for k in (1, 2)] == [0x186, 1]


def test_a_dcf_has_its_node_id_and_values() -> None:
    path = FIELD / "32-dcf-values" / "drive.dcf"
    assert own_node_id(path) == 12
    dictionary = load_object_dictionary(path)
    found = [dictionary.get_variable(*place).value for place in ((0x1017, 0), (0x2404, 1), (0x1800, 1), (0x1800, 2), (0x2405, 0))]
    assert found == [150, -777, 0x1CC, 5, "0.75"] or found == [150, -777, 0x1CC, 5, 0.75]
    read("32-dcf-values/drive.dcf", 5, "NodeID=12 is this file's, read here for node 5")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("13-eds-orphan/orphan.eds", r"object \[2022\] is missing"),
        ("eds-rules-bent/comment_behind_number.eds", "a comment behind a value begins with ;"),
        ("eds-rules-bent/limit_beyond_type.eds", "HighLimit=65536 is beyond its type and read as 65535"),
        ("eds-rules-bent/crash.eds", "DataType=0x000 of a communication object"),
    ],
)
def test_files_that_bend_the_rules_are_read_and_told(name: str, words: str) -> None:
    assert len(read(name, 5, words)) > 10
