"""Reader of electronic data sheets (CiA 306) as vendors write them, into an object dictionary of the `canopen` library.

The library's reader fails on the contents of real files: empty integers, bytes of a Windows code page, comments behind values, octal
numbers, negative defaults written as unsigned hex, sections in any case and order. So the text is normalised first and the library reads
clean text.
"""

from __future__ import annotations

import io
import re
import stat
from pathlib import Path

import canopen
from canopen.objectdictionary import datatypes

from drivers.errors import ProtocolError

_OBJECT = re.compile(r"^([0-9A-F]{4})(?:SUB([0-9A-F]{1,2}))?$")
_COMMENT = re.compile(r"\s;.*$")
_MAX_FILE_BYTES = 4_000_000  # the largest data sheets in the field are some hundred kilobytes
_MOST_ENTRIES = 16_384
"""Most objects and subindices of a file, compact arrays written out: real devices have some thousands. A line of a compact array stands
for 254 of them, so that a small file could stand for millions."""

_VARIABLE, _DOMAIN_OBJECT = 0x07, 0x02
_TEXT_KEYS = frozenset({"ParameterName", "AccessType", "VendorName", "ProductName", "OrderCode", "StorageLocation", "Denotation"})
_VALUE_KEYS = frozenset({"DefaultValue", "ParameterValue", "LowLimit", "HighLimit"})
_NUMBER_KEYS = frozenset(
    {"ObjectType", "DataType", "PDOMapping", "SubNumber", "CompactSubObj", "NodeID", "Baudrate", "VendorNumber", "ProductNumber"}
    | {"RevisionNumber", "SimpleBootUpMaster", "SimpleBootUpSlave", "Granularity", "DynamicChannelsSupported", "GroupMessaging"}
    | {"NrOfRXPDO", "NrOfTXPDO", "LSS_Supported"}
    | {f"BaudRate_{rate}" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)}
)
_CANONICAL_KEYS = {key.lower(): key for key in _TEXT_KEYS | _VALUE_KEYS | _NUMBER_KEYS}
_CANONICAL_SECTIONS = {
    "deviceinfo": "DeviceInfo",
    "devicecomissioning": "DeviceComissioning",  # the standard's own spelling
    "devicecommissioning": "DeviceComissioning",
}
_ACCESS_TYPES = frozenset({"ro", "wo", "rw", "rwr", "rww", "const"})
_LAST_BASIC_TYPE = datatypes.UNSIGNED64
_FIXED_BITS = {
    datatypes.BOOLEAN: 8,  # a byte over SDO
    **dict(zip((2, 3, 0x10, 4, 0x12, 0x13, 0x14, 0x15), (8, 16, 24, 32, 40, 48, 56, 64), strict=True)),
    **dict(zip((5, 6, 0x16, 7, 0x18, 0x19, 0x1A, 0x1B), (8, 16, 24, 32, 40, 48, 56, 64), strict=True)),
}

Sections = dict[str, dict[str, str]]


def load_object_dictionary(path: str | Path, node_id: int | None = None) -> canopen.ObjectDictionary:
    """Read an EDS or DCF file for one node.

    Parameters
    ----------
    path : path of the file
    node_id : int, optional
        1 to 127, put in where the file says ``$NODEID``. None takes the file's own [DeviceComissioning] node id.

    Returns
    -------
    canopen.ObjectDictionary
        `default` holds the data sheet's default, `value` the configured value of a DCF; signed integers are signed.

    Raises
    ------
    ProtocolError
        The file cannot be used; one line names the file, the section and the fault.
    """
    path = Path(path)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise ProtocolError(f"{path}: is a folder, device or pipe: an EDS or DCF is a regular file")
        if status.st_size > _MAX_FILE_BYTES:
            raise ProtocolError(f"{path}: {status.st_size} bytes: no EDS or DCF file is that large")
        text = _decode(path.read_bytes())
    except OSError as error:
        raise ProtocolError(f"{path}: cannot be read: {error.strerror or error}") from error
    return parse_object_dictionary(text, node_id, str(path))


def parse_object_dictionary(text: str, node_id: int | None = None, name: str = "EDS") -> canopen.ObjectDictionary:
    """Read the text of an EDS or DCF file like `load_object_dictionary`; `name` precedes every error message."""
    try:
        sections = _sections(text)
        if node_id is None:
            node_id = _own_node_id(sections)
        clean = _clean(sections, node_id)
        dictionary: canopen.ObjectDictionary = canopen.objectdictionary.eds.import_eds(  # type: ignore[no-untyped-call]
            io.StringIO(clean), node_id
        )
        dictionary.node_id = node_id
    except ProtocolError as error:
        raise ProtocolError(f"{name}: {error}") from None
    except Exception as error:  # whatever error the library raises, the user needs to know one thing: the file is broken
        raise ProtocolError(f"{name}: not a usable EDS or DCF file: {type(error).__name__}: {error}".replace("\n", " ")) from error
    if not any(index >= 0x1000 for index in dictionary):
        raise ProtocolError(f"{name}: no object from 1000h on: not an EDS or DCF file")
    return dictionary


def _decode(raw: bytes) -> str:
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            return raw.decode(encoding)
        except UnicodeDecodeError:
            continue
    return raw.decode("latin-1")


def _sections(text: str) -> Sections:
    """Return every section once, keys in the standard's spelling, without comments; the last of two equal keys counts."""
    sections: Sections = {}
    current: dict[str, str] | None = None
    for line in text.replace("\x00", "").splitlines():
        line = line.strip()
        if not line or line[0] in ";#":
            continue
        if line[0] == "[":
            if "]" not in line:
                raise ProtocolError(f"section head without ]: {line[:60]!r}")
            head = line[1 : line.index("]")].strip()
            current = sections.setdefault(_CANONICAL_SECTIONS.get(head.lower(), head.upper()), {})
        elif current is not None and "=" in line:
            key, value = line.split("=", 1)
            key = key.strip()
            current[_CANONICAL_KEYS.get(key.lower(), key)] = _COMMENT.sub("", " " + value).strip()
    return sections


def _own_node_id(sections: Sections) -> int | None:
    text = sections.get("DeviceComissioning", {}).get("NodeID", "")
    return _integer(text, None, "[DeviceComissioning] NodeID") if text else None


def _clean(sections: Sections, node_id: int | None) -> str:
    """Return text that the library can read: parents before children, plain numbers, nothing that it does not need."""
    out = io.StringIO()
    _resolve_own_types(sections)
    _emit(out, "DeviceInfo", _plain_numbers(sections.get("DeviceInfo", {}), "DeviceInfo"))
    _emit_dummies(out, sections.get("DUMMYUSAGE", {}))
    objects = sorted((match.group(1), int(match.group(2) or "-1", 16), head) for head in sections if (match := _OBJECT.match(head)))
    entries = len(objects) + sum(_compact_count(head, sections) for _, subindex, head in objects if subindex < 0)
    if entries > _MOST_ENTRIES:
        raise ProtocolError(f"{entries} objects and subindices, compact arrays written out: a data sheet has at most {_MOST_ENTRIES}")
    present = {index for index, subindex, _ in objects if subindex < 0}
    for index, subindex, head in objects:
        if subindex >= 0 and index not in present:
            raise ProtocolError(f"[{head}]: its object [{index}] is missing")
        name = index if subindex < 0 else f"{index}sub{subindex:X}"
        _emit(out, name, _object_keys(sections[head], name, node_id))
        if subindex < 0 and sections[head].get("CompactSubObj"):
            _emit_compact_array(out, index, sections, node_id)
    return out.getvalue()


def _resolve_own_types(sections: Sections) -> None:
    """Replace types beyond the basic ones: those defined in the file ([A0sub1], as by CANFestival) by their basic type, others by bytes."""
    for head, keys in sections.items():
        text = keys.get("DataType", "")
        if not text or not _OBJECT.match(head):
            continue
        data_type = _integer(text, None, f"[{head}] DataType")
        if data_type > _LAST_BASIC_TYPE:
            definition = sections.get(f"{data_type:X}SUB1", {}).get("DefaultValue", "")
            keys["DataType"] = definition or str(datatypes.DOMAIN)


def _emit(out: io.StringIO, head: str, keys: dict[str, str]) -> None:
    out.write(f"[{head}]\n")
    for key, value in keys.items():
        out.write(f"{key}={value}\n")


def _emit_dummies(out: io.StringIO, given: dict[str, str]) -> None:
    lower = {key.lower(): value for key, value in given.items()}
    _emit(out, "DummyUsage", {f"Dummy{i:04d}": "1" if lower.get(f"dummy{i:04d}") in ("1", "0x1", "0x01") else "0" for i in range(1, 8)})


def _emit_compact_array(out: io.StringIO, index: str, sections: Sections, node_id: int | None) -> None:
    """Write out a compact array: every element has the array's type, and its own name and value where the file lists them."""
    keys = sections[index]
    count = _compact_count(index, sections)
    names, values = sections.get(f"{index}NAME", {}), sections.get(f"{index}VALUE", {})
    size = {"ParameterName": "Number of entries", "DataType": "5", "AccessType": "ro", "DefaultValue": str(count)}
    _emit(out, f"{index}sub0", _object_keys(size, f"{index}sub0", node_id))
    for i in range(1, count + 1):
        element = {key: value for key, value in keys.items() if key not in ("CompactSubObj", "ObjectType")}
        element["ParameterName"] = names.get(str(i)) or f"{keys.get('ParameterName', index)} {i}"
        if str(i) in values:
            element["ParameterValue"] = values[str(i)]
        _emit(out, f"{index}sub{i:X}", _object_keys(element, f"{index}sub{i:X}", node_id))


def _compact_count(index: str, sections: Sections) -> int:
    """Return the number of elements of a compact array, 0 for another object."""
    count = _integer(sections[index].get("CompactSubObj") or "0", None, f"[{index}] CompactSubObj")
    if not 0 <= count <= 254:
        raise ProtocolError(f"[{index}]: CompactSubObj={count}: must be 0 to 254")
    return count


def _plain_numbers(keys: dict[str, str], head: str) -> dict[str, str]:
    """Return number-like keys as plain decimals, without empty or unreadable ones of the file's own description."""
    plain = {}
    for key, value in keys.items():
        if key in _TEXT_KEYS:
            plain[key] = value
        elif value:
            try:
                plain[key] = str(_integer(value, None, f"[{head}] {key}"))
            except ProtocolError:
                continue  # [DeviceInfo] is for human readers; nothing here depends on it
    return plain


def _object_keys(keys: dict[str, str], head: str, node_id: int | None) -> dict[str, str]:
    """Return the keys of one object or subindex, complete and with plain numbers."""
    clean = {"ParameterName": keys.get("ParameterName") or f"Object {head}"}
    object_type = _integer(keys.get("ObjectType") or "7", None, f"[{head}] ObjectType")
    clean["ObjectType"] = str(object_type)
    if keys.get("StorageLocation"):
        clean["StorageLocation"] = keys["StorageLocation"]
    if object_type not in (_VARIABLE, _DOMAIN_OBJECT):
        return clean
    return clean | _variable_keys(keys, head, object_type, node_id)


def _variable_keys(keys: dict[str, str], head: str, object_type: int, node_id: int | None) -> dict[str, str]:
    """Return the keys of a variable: type, access, mapping, and its values in the form of its type."""
    if not keys.get("DataType") and object_type != _DOMAIN_OBJECT:
        raise ProtocolError(f"[{head}]: DataType is missing")
    data_type = _integer(keys.get("DataType") or "0xF", None, f"[{head}] DataType")
    access = (keys.get("AccessType") or "rw").lower()
    if access not in _ACCESS_TYPES:
        raise ProtocolError(f"[{head}]: AccessType={access}: must be one of {', '.join(sorted(_ACCESS_TYPES))}")
    mappable = keys.get("PDOMapping", "0").lower() in ("1", "0x1", "0x01", "true")
    clean = {"DataType": str(data_type), "AccessType": access, "PDOMapping": str(int(mappable))}
    for key in _VALUE_KEYS & keys.keys():
        if (value := keys[key]) != "" or data_type in (datatypes.VISIBLE_STRING, datatypes.UNICODE_STRING):
            clean[key] = _typed(value, data_type, node_id, f"[{head}] {key}")
    return clean


def _typed(value: str, data_type: int, node_id: int | None, where: str) -> str:
    """Return a value in the library's form: plain integers in the range of their type, negative where the type is signed."""
    if data_type not in _FIXED_BITS:
        return value
    if "$NODEID" in value.upper() and node_id is None:
        return value
    number = {"true": 1, "false": 0}.get(value.lower())
    if number is None:
        number = _integer(value, node_id, where)
    bits = _FIXED_BITS[data_type]
    if not -(1 << (bits - 1)) <= number < 1 << bits:
        raise ProtocolError(f"{where}={value}: does not fit into {bits} bits")
    number &= (1 << bits) - 1
    if data_type in datatypes.SIGNED_TYPES and number >> (bits - 1):
        number -= 1 << bits
    return str(number)


def _integer(text: str, node_id: int | None, where: str) -> int:
    """Read a CiA 306 number: decimal, hex after 0x, octal after a leading 0, and sums with ``$NODEID``."""
    total = 0
    for raw in text.replace(" ", "").upper().split("+"):
        if raw == "$NODEID" and node_id is not None:
            total += node_id
            continue
        try:
            octal = re.fullmatch(r"(-?)0([0-7]+)", raw)
            total += int(octal.group(1) + octal.group(2), 8) if octal else int(raw.removesuffix("U").removesuffix("L"), 0)
        except ValueError:
            if re.fullmatch(r"0+[89][0-9]*|0[0-9]*[89][0-9]*", raw):  # decimal with leading zeros
                total += int(raw, 10)
                continue
            raise ProtocolError(f"{where}={text[:40]}: must be an integer") from None
    return total
