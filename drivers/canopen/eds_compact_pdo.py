"""PDOs that a data sheet does not describe, because its CompactPDO says that they are as CiA 301 has them (CiA 306, [DeviceInfo])."""

from __future__ import annotations

from drivers.canopen.eds_modules import Integer
from drivers.canopen.eds_repairs import Repairs, Section, Sections, standard_type

_BITS_OF_A_PDO = 64
_MOST_PDOS = 512
_PREDEFINED = 4
"""PDOs of each direction with a COB-ID from the predefined connection set (CiA 301, 7.3.3)."""

_SWITCHED_OFF = 0x80000000
_DIRECTIONS = (("NrOfRXPDO", 0x1400, 0x200), ("NrOfTXPDO", 0x1800, 0x180))
_NAMES = {1: "COB-ID", 2: "Transmission type", 3: "Inhibit time", 4: "Compatibility entry", 5: "Event timer", 6: "SYNC start value"}


def describe_compact_pdos(sections: Sections, repairs: Repairs, integer: Integer) -> None:
    """Add the records of PDOs that [DeviceInfo] counts and no section describes; its CompactPDO has a bit for each of their subindices.

    Their mapping is empty: what the device maps by itself is in no such file. It has as many entries as bits of the granularity fit.
    """
    info = sections.get("DeviceInfo", Section(0))

    def number(key: str) -> int:
        return integer(info[key], f"[DeviceInfo] {key}") if info.get(key) else 0

    mask, granularity = number("CompactPDO") & 0xFF, number("Granularity")
    if not mask:
        return
    subindices = dict.fromkeys((bit + 1 for bit in range(8) if mask >> bit & 1), "")
    for key, communication, cob_id in _DIRECTIONS:
        added = [k for k in range(min(number(key), _MOST_PDOS)) if f"{communication + k:04X}" not in sections]
        for k in added:
            first = f"$NODEID+0x{cob_id + 0x100 * k:X}" if k < _PREDEFINED else f"0x{_SWITCHED_OFF:X}"
            defaults = subindices | ({1: first} if 1 in subindices else {})
            _record(sections, communication + k, "PDO communication parameter", defaults, info)
            entries = _BITS_OF_A_PDO // granularity if 1 <= granularity <= _BITS_OF_A_PDO else 0
            if entries and f"{communication + 0x200 + k:04X}" not in sections:
                _record(sections, communication + 0x200 + k, "PDO mapping parameter", dict.fromkeys(range(1, entries + 1), "0"), info)
        if added:
            ends = f"{communication + added[0]:04X}h" + (f" to {communication + added[-1]:04X}h" if len(added) > 1 else "")
            words = f"{key}={number(key)} with CompactPDO: {ends} not described, read as CiA 301's, nothing mapped"
            repairs.add(words, info.line_of("CompactPDO"))


def _record(sections: Sections, index: int, name: str, defaults: dict[int, str], info: Section) -> None:
    line = info.line_of("CompactPDO")
    head = f"{index:04X}"
    sections[head] = Section(line, {"ParameterName": name, "ObjectType": "9"})
    is_mapping = bool(index & 0x200)
    size = {"ParameterName": "Highest subindex", "DataType": "5", "AccessType": "rw" if is_mapping else "ro"}
    sections[f"{head}SUB0"] = Section(line, {**size, "DefaultValue": "0" if is_mapping else str(max(defaults))})
    for subindex, default in defaults.items():
        keys = {"ParameterName": "Mapped object" if is_mapping else _NAMES.get(subindex, "Reserved"), "AccessType": "rw"}
        keys["DataType"] = str(standard_type(index, subindex) or 5)
        sections[f"{head}SUB{subindex:X}"] = Section(line, {**keys, "DefaultValue": default})
