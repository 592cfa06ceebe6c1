"""What of a data sheet is not taken, told line by line: sections, keys, elements beyond their array, objects that are listed alone."""

from __future__ import annotations

import re

from drivers.canopen.eds_modules import MODULE, Integer, entries_of
from drivers.canopen.eds_repairs import Repairs, Section, Sections

OBJECT = re.compile(r"^([0-9A-F]{4})(?:SUB([0-9A-F]{1,2}))?$")
_OF_COMPACT = re.compile(r"^([0-9A-F]{4})(NAME|VALUE)$")
_ABOUT_THE_FILE = ("DeviceInfo", "DeviceComissioning", "DUMMYUSAGE", "FILEINFO", "COMMENTS", "SUPPORTEDMODULES", "CONNECTEDMODULES")
_LISTS = ("MANDATORYOBJECTS", "OPTIONALOBJECTS", "MANUFACTUREROBJECTS")
_TAKEN = frozenset({"ParameterName", "ObjectType", "DataType", "AccessType", "PDOMapping", "SubNumber", "CompactSubObj", "StorageLocation"})
_TAKEN_OF_COMMISSIONING = frozenset({"NodeID", "Baudrate"})
_TAKEN_OF_VALUES = frozenset({"DefaultValue", "ParameterValue", "LowLimit", "HighLimit"})
_NOTHING = re.compile(r"(0[xX])?0*")
"""Of a key that is left empty, or is zero, nothing is lost."""

_FIRST_OBJECT = 0x1000
"""Below are types, which are taken where an object has them."""

_SHOWN = 8
"""Names in one message."""


def tell_left_out(sections: Sections, repairs: Repairs, integer: Integer) -> None:
    """Tell which sections, keys and elements are not taken, and which objects are listed and have no section, or too few subindices."""
    others = [head for head in sections if not _is_taken(head, sections)]
    for head in others:
        repairs.add(f"not taken: {_names(others)}", sections[head].line)
    for head in _LISTS:
        listed = [f"{index:04X}" for index in entries_of(sections.get(head, Section(0)), head, integer)]
        if missing := [index for index in listed if index not in sections]:
            repairs.add(f"listed without a section, and so not there: {_names(missing)}", sections[head].line)
    _tell_keys(sections.get("DeviceComissioning", Section(0)), _TAKEN_OF_COMMISSIONING, repairs)
    for head, keys in sections.items():
        if (match := OBJECT.match(head)) and int(match[1], 16) >= _FIRST_OBJECT:
            _tell_keys(keys, _TAKEN | _TAKEN_OF_VALUES, repairs)
            if not match[2]:
                _tell_subindices(head, sections, repairs, integer)
        elif compact := _OF_COMPACT.match(head):
            _tell_elements(compact[1], head, sections, repairs, integer)


def _names(heads: list[str]) -> str:
    return ", ".join(f"[{head}]" for head in heads[:_SHOWN]) + (", ..." if len(heads) > _SHOWN else "")


def _is_taken(head: str, sections: Sections) -> bool:
    if head in (*_ABOUT_THE_FILE, *_LISTS) or OBJECT.match(head) or MODULE.match(head):
        return True
    compact = _OF_COMPACT.match(head)
    return compact is not None and bool(sections.get(compact[1], Section(0)).get("CompactSubObj"))


def _tell_keys(keys: Section, taken: frozenset[str], repairs: Repairs) -> None:
    lost = [key for key, value in keys.items() if key not in taken and not _NOTHING.fullmatch(value)]
    for key in lost:
        repairs.add(f"{', '.join(lost)} {'was' if len(lost) == 1 else 'were'} not taken", keys.line_of(key))


def _tell_subindices(head: str, sections: Sections, repairs: Repairs, integer: Integer) -> None:
    """Tell of an object with fewer subindices than it says."""
    keys = sections[head]
    if not keys.get("SubNumber") or keys.get("CompactSubObj"):
        return
    said, there = integer(keys["SubNumber"], f"[{head}] SubNumber"), sum(other.startswith(f"{head}SUB") for other in sections)
    if said > there:
        repairs.add(f"[{head}] says {said} subindices, {there} are described", keys.line_of("SubNumber"))


def _tell_elements(index: str, head: str, sections: Sections, repairs: Repairs, integer: Integer) -> None:
    """Tell of names and values for which a compact array has no element."""
    text = sections.get(index, Section(0)).get("CompactSubObj", "")
    last = integer(text, f"[{index}] CompactSubObj") if text else 0
    keys = sections[head]
    for key in keys if last else ():
        if key.isdigit() and not 1 <= int(key) <= last:
            repairs.add(f"[{index}] has {last} elements: a value or name of another was not taken", keys.line_of(key))
