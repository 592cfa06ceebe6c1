"""Modular devices in data sheets (CiA 306, 4.7): the objects that modules plugged on a coupler add."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from drivers.canopen.eds_repairs import Repairs, Section, Sections

MODULE = re.compile(r"^M(\d+)(MODULEINFO|COMMENTS|FIXEDOBJECTS|SUBEXTENDS|(FIXED|SUBEXT)([0-9A-F]{4})(?:SUB([0-9A-F]{1,2}))?)$")
_OBJECT = re.compile(r"^([0-9A-F]{4})(?:SUB([0-9A-F]{1,2}))?$")
_MOST_SUBINDEX = 254
_SHOWN = 8
"""Names in one message."""

Integer = Callable[[str, str], int]
"""Reads a number of CiA 306; the second argument says where it stands."""


@dataclass(frozen=True)
class _Extension:
    """Subindices that one module adds to an object."""

    index: int
    count: int
    next_object: int  # distance of the object that goes on where this one is full; 0: none does
    head: str


def connect_modules(sections: Sections, repairs: Repairs, integer: Integer) -> None:
    """Add the objects of the modules that [ConnectedModules] names, in its order, and tell which are not connected."""
    described = sorted({int(match[1]) for head in sections if (match := MODULE.match(head))})
    connected = list(entries_of(sections.get("CONNECTEDMODULES", Section(0)), "ConnectedModules", integer))
    for number in sorted(set(connected) - set(described)):
        repairs.add(f"module {number} is connected and not described: it adds nothing", sections["CONNECTEDMODULES"].line)
    if free := [number for number in described if number not in connected]:
        names = ", ".join(f"M{number} {_info(sections, number).get('ProductName', '')}".strip() for number in free[:_SHOWN])
        words = f"module{'s' if len(free) > 1 else ''} {names} described and not connected; [ConnectedModules] of a DCF says which are"
        repairs.add(words, min(_info(sections, number).line for number in free))
    extensions: dict[int, list[_Extension]] = {}
    for number in connected:
        _tell_missing(sections, repairs, number, integer)
        for head in [head for head in sections if head.startswith(f"M{number}")]:
            match = MODULE.match(head)
            if match is None or int(match[1]) != number or match[3] is None:
                continue
            if match[3] == "FIXED":
                sections.setdefault(match[4] + (f"SUB{match[5]}" if match[5] else ""), sections[head])
            else:
                keys = sections[head]
                count, next_object = (_number(keys, key, default, head, integer) for key, default in (("Count", "1"), ("ObjExtend", "0")))
                index = int(match[4], 16)
                extensions.setdefault(index, []).append(_Extension(index, count, next_object, head))
    for those in extensions.values():
        _extend(sections, repairs, those)


def _tell_missing(sections: Sections, repairs: Repairs, number: int, integer: Integer) -> None:
    """Tell which objects a module's lists name without a section of them."""
    for title, part in (("SubExtends", "SubExt"), ("FixedObjects", "Fixed")):
        listing = sections.get(f"M{number}{title.upper()}", Section(0))
        indices = entries_of(listing, f"M{number}{title}", integer)
        if lacking := [f"[M{number}{part}{index:04X}]" for index in indices if f"M{number}{part.upper()}{index:04X}" not in sections]:
            more = f" and {len(lacking) - _SHOWN} more" if lacking[_SHOWN:] else ""
            repairs.add(f"[M{number}{title}] lists objects without a section: {', '.join(lacking[:_SHOWN])}{more}", listing.line)


def _info(sections: Sections, number: int) -> Section:
    return sections.get(f"M{number}MODULEINFO") or next(
        keys for head, keys in sections.items() if (match := MODULE.match(head)) and int(match[1]) == number
    )


def entries_of(keys: Section, head: str, integer: Integer) -> Iterator[int]:
    """Yield the numbers of a section's lines 1, 2, ..."""
    for key, value in keys.items():
        if key.isdigit() and value:
            yield integer(value, f"[{head}] {key}")


def _number(keys: Section, key: str, default: str, head: str, integer: Integer) -> int:
    """Return a number of an extension; of `1;2`, a subindex that two modules of less than a byte fill, the first."""
    return integer((keys.get(key) or default).partition(";")[0], f"[{head}] {key}")


def _extend(sections: Sections, repairs: Repairs, extensions: list[_Extension]) -> None:
    """Add the subindices that modules add to one object, in their order, unless the file has them written out."""
    name = f"{extensions[0].index:04X}"
    there = _last_subindex(sections, name)
    if there >= sum(one.count for one in extensions):
        words = f"[{name}] has {there} subindices: those of the connected modules are taken to be among them"
        repairs.add(words, sections[extensions[0].head].line)
        return
    index = extensions[0].index
    for one in extensions:
        for _ in range(one.count):
            if _last_subindex(sections, f"{index:04X}") >= _MOST_SUBINDEX:
                if not one.next_object:
                    repairs.add(f"[{name}] is full: subindices of a module are left out", sections[one.head].line)
                    break
                index += one.next_object
            _add(sections, f"{index:04X}", sections[one.head])


def _add(sections: Sections, name: str, extension: Section) -> None:
    """Add one subindex."""
    if name not in sections:
        sections[name] = Section(extension.line, {"ParameterName": f"Object {name}", "ObjectType": "8"})
    subindex = _last_subindex(sections, name) + 1
    keys = {key: value for key, value in extension.items() if key not in ("Count", "ObjExtend", "ObjectType")}
    keys["ParameterName"] = keys.get("ParameterName", f"Object {name}").replace("%d", str(subindex))
    sections[f"{name}SUB{subindex:X}"] = Section(extension.line, keys)
    size = sections.setdefault(f"{name}SUB0", Section(extension.line, {"DataType": "5", "AccessType": "ro"}))
    size["DefaultValue"] = str(subindex)
    size.pop("ParameterValue", None)


def _last_subindex(sections: Sections, name: str) -> int:
    compact = sections.get(name, Section(0)).get("CompactSubObj", "")
    written = [int(match[2], 16) for head in sections if (match := _OBJECT.match(head)) and match[1] == name and match[2]]
    return max([*written, int(compact, 0) if compact.lstrip("0xX").isalnum() else 0, 0])
