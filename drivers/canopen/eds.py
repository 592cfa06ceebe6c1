"""Reader of electronic data sheets (CiA 306) as vendors write them, into an object dictionary of the `canopen` library.

The library's reader fails on the contents of real files: empty integers, bytes of a Windows code page, comments behind values, octal
numbers, negative defaults written as unsigned hex, sections in any case and order. So the text is normalised first and the library reads
clean text. What the standard does not allow and a reader can still understand is repaired, and told in one warning with its lines.
"""

from __future__ import annotations

import codecs
import functools
import io
import pickle
import re
import stat
import warnings
from pathlib import Path

import canopen
from canopen.objectdictionary import datatypes

from drivers.canopen.eds_compact_pdo import describe_compact_pdos
from drivers.canopen.eds_left_out import OBJECT, tell_left_out
from drivers.canopen.eds_modules import connect_modules
from drivers.canopen.eds_numbers import NODE_ID, NUMBER, in_librarys_form, integer, limit_of_type
from drivers.canopen.eds_repairs import RECORDS, Repairs, Section, Sections, standard_type
from drivers.errors import DataSheetWarning, ProtocolError

_OBJECT_HEAD = re.compile(r"(?mi)^[ \t]*\[[ \t]*[0-9A-F]{4}(?:SUB[0-9A-F]{1,2})?[ \t]*\]")
_COMMENT = re.compile(r"\s;.*$")
_HASH_COMMENT = re.compile(r"(?<=\S)\s+(#|//).*$")
_HEX_WITH_H = re.compile(r"([0-9][0-9A-Fa-f ]*)[hH]")  # begins with a digit, as no word does
_MAX_FILE_BYTES = 4_000_000  # the largest data sheets in the field are some hundred kilobytes
_MOST_ENTRIES = 16_384
"""Most objects and subindices of a file, compact arrays written out: real devices have some thousands. A line of a compact array stands
for 254 of them, so that a small file could stand for millions."""

_MOST_NODES = 127
_VARIABLE, _DOMAIN_OBJECT = 0x07, 0x02
_FIRST_OBJECT = 0x1000
"""Below are types, which are taken where an object has them."""

_MANY = (0x08, 0x09)  # array and record: their type is that of their elements
_TEXT_KEYS = frozenset({"ParameterName", "AccessType", "VendorName", "ProductName", "OrderCode", "StorageLocation", "Denotation"})
_FREE_TEXT = _TEXT_KEYS - {"AccessType"}
_VALUE_KEYS = frozenset({"DefaultValue", "ParameterValue", "LowLimit", "HighLimit"})
HEARTBEAT_CONSUMER, MOST_HEARTBEAT_MS = "1016SUB", 1 << 16  # node id above 16 bits of milliseconds
_LIMIT_KEYS = frozenset({"LowLimit", "HighLimit"})
_NUMBER_KEYS = frozenset(
    {"ObjectType", "DataType", "PDOMapping", "SubNumber", "CompactSubObj", "NodeID", "Baudrate", "VendorNumber", "ProductNumber"}
    | {"RevisionNumber", "SimpleBootUpMaster", "SimpleBootUpSlave", "Granularity", "DynamicChannelsSupported", "GroupMessaging"}
    | {"NrOfRXPDO", "NrOfTXPDO", "LSS_Supported", "Count", "ObjExtend", "CompactPDO"}
    | {f"BaudRate_{rate}" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)}
)
_CANONICAL_KEYS = {key.lower(): key for key in _TEXT_KEYS | _VALUE_KEYS | _NUMBER_KEYS}
_CANONICAL_SECTIONS = {
    "deviceinfo": "DeviceInfo",
    "devicecomissioning": "DeviceComissioning",  # the standard's own spelling
    "devicecommissioning": "DeviceComissioning",
}
_WORDS = {"true": 1, "false": 0}
_ACCESS_TYPES = frozenset({"ro", "wo", "rw", "rwr", "rww", "const"})
TEXTS_KEPT = 16
"""Texts that are not read again: a run opens its machine twice, each time with all nodes."""
_LAST_BASIC_TYPE = datatypes.UNSIGNED64
_FIXED_BITS = {
    datatypes.BOOLEAN: 8,  # a byte over SDO
    **dict(zip((2, 3, 0x10, 4, 0x12, 0x13, 0x14, 0x15), (8, 16, 24, 32, 40, 48, 56, 64), strict=True)),
    **dict(zip((5, 6, 0x16, 7, 0x18, 0x19, 0x1A, 0x1B), (8, 16, 24, 32, 40, 48, 56, 64), strict=True)),
}


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

    Warns
    -----
    DataSheetWarning
        The file bends the rules: which lines, and what was read instead.

    Raises
    ------
    ProtocolError
        The file cannot be used; one line names the file, the section and the fault.
    """
    return parse_object_dictionary(_text_of(Path(path)), node_id, str(path))


def own_node_id(path: str | Path) -> int | None:
    """Return the node id in a DCF's [DeviceComissioning]; None where the file has none. ProtocolError as in `load_object_dictionary`."""
    repairs = Repairs()
    try:
        return _own_node_id(_sections(_text_of(Path(path)), repairs), repairs)
    except ProtocolError as error:
        raise ProtocolError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from None


def _text_of(path: Path) -> str:
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise ProtocolError(f"{path}: is a folder, device or pipe: an EDS or DCF is a regular file")
        if status.st_size > _MAX_FILE_BYTES:
            raise ProtocolError(f"{path}: {status.st_size} bytes: no EDS or DCF file is that large")
        return _decode(path.read_bytes())
    except OSError as error:
        raise ProtocolError(f"{path}: cannot be read: {error.strerror or error}") from error


def parse_object_dictionary(text: str, node_id: int | None = None, name: str = "EDS") -> canopen.ObjectDictionary:
    """Read the text of an EDS or DCF file like `load_object_dictionary`; `name` precedes every error message."""
    try:
        pickled, repairs = _read_once(text, node_id)
    except ProtocolError as error:
        raise ProtocolError(f"{name}: {error}") from None
    except Exception as error:  # whatever error the library raises, the user needs to know one thing: the file is broken
        raise ProtocolError(f"{name}: not a usable EDS or DCF file: {type(error).__name__}: {error}".replace("\n", " ")) from error
    dictionary: canopen.ObjectDictionary = pickle.loads(pickled)  # our own
    if not any(index >= _FIRST_OBJECT for index in dictionary):
        raise ProtocolError(f"{name}: no object from 1000h on: not an EDS or DCF file")
    if repairs:
        warnings.warn(f"{name}: {repairs}", DataSheetWarning, stacklevel=2)
    return dictionary


@functools.lru_cache(maxsize=TEXTS_KEPT)
def _read_once(text: str, node_id: int | None) -> tuple[bytes, Repairs]:
    """Return the dictionary of a text, pickled since each node changes its own, and what the file bends."""
    repairs = Repairs()
    sections = _sections(text, repairs)
    own = _own_node_id(sections, repairs)
    if node_id is None:
        node_id = own
    elif own is not None and own != node_id:
        line = sections["DeviceComissioning"].line_of("NodeID")
        repairs.add(f"NodeID={own} is this file's, read here for node {node_id}; what follows the node id follows this one", line)
    clean = _Reader(sections, node_id, repairs).clean()
    dictionary: canopen.ObjectDictionary = canopen.objectdictionary.eds.import_eds(  # type: ignore[no-untyped-call]
        io.StringIO(clean), node_id
    )
    dictionary.node_id = node_id
    dictionary.bitrate = _own_bit_rate(sections, repairs)
    return pickle.dumps(dictionary), repairs


def _decode(raw: bytes) -> str:
    if raw[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return raw.decode("utf-16", "replace")
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            return raw.decode(encoding)
        except UnicodeDecodeError:
            continue
    return raw.decode("latin-1")


def _sections(text: str, repairs: Repairs) -> Sections:
    """Return every section once, keys in the standard's spelling, without comments; the last of two equal keys counts."""
    if text.lstrip()[:1] == "<":
        raise ProtocolError("begins with <, as XML does (XDD and XDC of CiA 311); read are EDS and DCF of CiA 306")
    _refuse_too_many(len(_OBJECT_HEAD.findall(text)))  # before any of them is read
    sections: Sections = {}
    current: Section | None = None
    for number, line in enumerate(text.replace("\x00", "").splitlines(), start=1):
        line = line.strip()
        if not line or line[0] in ";#":
            continue
        if line[0] == "[":
            if "]" not in line:
                raise ProtocolError(f"section head without ]: {line[:60]!r}")
            head = line[1 : line.index("]")].strip()
            name = _CANONICAL_SECTIONS.get(head.lower(), head.upper())
            if name in sections:
                repairs.add("a section that stands twice is read as one, the last of two equal keys counts", number)
            current = sections.setdefault(name, Section(number))
        elif current is None or "=" not in line:
            repairs.add("a line that is no section and no key of one was left out", number)
        else:
            key, value = line.split("=", 1)
            key = _CANONICAL_KEYS.get(key.strip().lower(), key.strip())
            value = _COMMENT.sub("", " " + value).strip()
            if ("#" in value or "/" in value) and key not in _FREE_TEXT and _HASH_COMMENT.search(value):
                value = _HASH_COMMENT.sub("", value)
                repairs.add("a comment behind a value begins with ;, another was left out", number)
            if current.get(key, value) != value:
                repairs.add("a key that stands twice in its section has the last value", number)
            current.put(key, value, number)
    return sections


def _refuse_too_many(entries: int) -> None:
    if entries > _MOST_ENTRIES:
        raise ProtocolError(f"{entries} objects and subindices, compact arrays written out: a data sheet has at most {_MOST_ENTRIES}")


def _own_node_id(sections: Sections, repairs: Repairs) -> int | None:
    section = sections.get("DeviceComissioning", Section(0))
    text = section.get("NodeID", "")
    number = integer(text, None, "[DeviceComissioning] NodeID") if text else None
    if number is not None and not 1 <= number <= _MOST_NODES:
        repairs.add(f"NodeID={text[:40]} is no node id (1 to {_MOST_NODES}) and was left out", section.line_of("NodeID"))
        return None
    return number


def _own_bit_rate(sections: Sections, repairs: Repairs) -> int | None:
    """Return the bit rate [bit/s] in a DCF's [DeviceComissioning]; None where it has none."""
    section = sections.get("DeviceComissioning", Section(0))
    if not (text := section.get("Baudrate", "")):
        return None
    try:
        return 1000 * integer(text, None, "[DeviceComissioning] Baudrate")
    except ProtocolError:
        repairs.add(f"Baudrate={text[:40]} is no number and was left out", section.line_of("Baudrate"))
        return None


class _Reader:
    """Makes text that the library can read: parents before children, plain numbers, nothing that it does not need.

    Parameters
    ----------
    sections : Sections
    node_id : int, optional
    repairs : Repairs
        Takes what had to be read in another way than it stands there.
    """

    def __init__(self, sections: Sections, node_id: int | None, repairs: Repairs) -> None:
        self._sections, self._node_id, self._repairs = sections, node_id, repairs
        self._out = io.StringIO()

    def clean(self) -> str:
        """Return the text."""
        sections = self._sections
        for read in (describe_compact_pdos, connect_modules, tell_left_out):
            read(sections, self._repairs, lambda value, where: integer(value, None, where))
        self._resolve_own_types()
        self._emit("DeviceInfo", _plain_numbers(sections.get("DeviceInfo", Section(0)), "DeviceInfo"))
        self._emit_dummies(sections.get("DUMMYUSAGE", Section(0)))
        self._adopt_orphans()
        objects = sorted((match.group(1), int(match.group(2) or "-1", 16), head) for head in sections if (match := OBJECT.match(head)))
        _refuse_too_many(len(objects) + sum(self._compact_count(head) for _, subindex, head in objects if subindex < 0))
        for index, subindex, head in objects:
            name = index if subindex < 0 else f"{index}sub{subindex:X}"
            self._tell_valueless(sections[head], head)
            self._emit(name, self._object_keys(sections[head], name))
            if subindex < 0 and sections[head].get("CompactSubObj"):
                self._emit_compact_array(index)
        return self._out.getvalue()

    def _tell_valueless(self, keys: Section, head: str) -> None:
        """Tell of an object that holds no value."""
        object_type = integer(keys.get("ObjectType") or "7", None, f"[{head}] ObjectType")
        if object_type not in (_VARIABLE, _DOMAIN_OBJECT, *_MANY) and int(head[:4], 16) >= _FIRST_OBJECT:
            self._repairs.add(f"an object with ObjectType={object_type} holds no value and was left out", keys.line)

    def _adopt_orphans(self) -> None:
        """Give subindices whose object is missing a record of their own."""
        orphans: dict[str, list[int]] = {}
        for head, section in self._sections.items():
            match = OBJECT.match(head)
            if match and match.group(2) and match.group(1) not in self._sections:
                orphans.setdefault(match.group(1), []).append(section.line)
        for index, lines in orphans.items():
            for line in lines:
                self._repairs.add(f"object [{index}] is missing; its subindices are read as a record", line)
            record = self._sections[index] = Section(lines[0])
            record.put("ParameterName", f"Object {index}", lines[0])
            record.put("ObjectType", "9", lines[0])

    def _resolve_own_types(self) -> None:
        """Replace types beyond the basic ones by a basic type.

        Those defined in the file ([A0sub1], as by CANFestival) have theirs; those of the communication profile have the standard's;
        all others are bytes.
        """
        for head, keys in self._sections.items():
            match = OBJECT.match(head)
            if match is None:
                continue
            text = keys.get("DataType", "")
            standard = standard_type(int(match.group(1), 16), int(match.group(2) or "0", 16)) if match.group(2) or text else None
            data_type = integer(text, None, f"[{head}] DataType") if text else None
            if data_type in RECORDS and keys.get("CompactSubObj"):
                continue  # its elements have the types of that record
            if data_type is not None and data_type > _LAST_BASIC_TYPE:
                definition = self._sections.get(f"{data_type:X}SUB1", Section(0)).get("DefaultValue", "")
                keys["DataType"] = definition or str(datatypes.DOMAIN)
                data_type = integer(keys["DataType"], None, f"[{head}] DataType")
            if standard is None or data_type == standard or integer(keys.get("ObjectType") or "7", None, f"[{head}] ObjectType") in _MANY:
                continue
            given = "no DataType" if data_type is None else f"DataType={text}"
            self._repairs.add(f"{given} of a communication object is read as CiA 301's {standard:04X}h", keys.line_of("DataType"))
            keys["DataType"] = str(standard)

    def _emit(self, head: str, keys: dict[str, str]) -> None:
        self._out.write(f"[{head}]\n")
        for key, value in keys.items():
            self._out.write(f"{key}={value}\n")

    def _emit_dummies(self, given: dict[str, str]) -> None:
        lower = {key.lower(): value for key, value in given.items()}
        self._emit("DummyUsage", {f"Dummy{i:04d}": "1" if lower.get(f"dummy{i:04d}") in ("1", "0x1", "0x01") else "0" for i in range(1, 8)})

    def _emit_compact_array(self, index: str) -> None:
        """Write out a compact array: every element has the array's type, and its own name and value where the file lists them."""
        sections = self._sections
        keys = sections[index]
        count = self._compact_count(index)
        names: dict[str, str] = sections.get(f"{index}NAME", Section(0))
        values: dict[str, str] = sections.get(f"{index}VALUE", Section(0))
        size = {"ParameterName": "Number of entries", "DataType": "5", "AccessType": "ro", "DefaultValue": str(count)}
        if f"{index}SUB0" not in sections:
            self._emit(f"{index}sub0", self._object_keys(Section(keys.line, size), f"{index}sub0"))
        record = integer(keys.get("DataType") or "0", None, f"[{index}] DataType")
        for i in range(1, count + 1):
            if f"{index}SUB{i:X}" in sections:
                continue
            element = Section(keys.line, {key: value for key, value in keys.items() if key not in ("CompactSubObj", "ObjectType")})
            if record in RECORDS:
                element["DataType"] = str(RECORDS[record].get(i, RECORDS[record][0]))
            elif not element.get("DataType") and (standard := standard_type(int(index, 16), i)) is not None:
                element["DataType"] = str(standard)
            element["ParameterName"] = names.get(str(i)) or f"{keys.get('ParameterName', index)} {i}"
            if str(i) in values:
                element["ParameterValue"] = values[str(i)]
            self._emit(f"{index}sub{i:X}", self._object_keys(element, f"{index}sub{i:X}"))

    def _compact_count(self, index: str) -> int:
        """Return the number of elements of a compact array, 0 for another object."""
        count = integer(self._sections[index].get("CompactSubObj") or "0", None, f"[{index}] CompactSubObj")
        if not 0 <= count <= 254:
            raise ProtocolError(f"[{index}]: CompactSubObj={count}: must be 0 to 254")
        return count

    def _object_keys(self, keys: Section, head: str) -> dict[str, str]:
        """Return the keys of one object or subindex, complete and with plain numbers."""
        clean = {"ParameterName": keys.get("ParameterName") or f"Object {head}"}
        object_type = self._number(keys, "ObjectType", "7", head)
        clean["ObjectType"] = str(object_type)
        if keys.get("StorageLocation"):
            clean["StorageLocation"] = keys["StorageLocation"]
        if object_type not in (_VARIABLE, _DOMAIN_OBJECT):
            return clean
        return clean | self._variable_keys(keys, head, object_type)

    def _variable_keys(self, keys: Section, head: str, object_type: int) -> dict[str, str]:
        """Return the keys of a variable: type, access, mapping, and its values in the form of its type."""
        if not keys.get("DataType") and object_type != _DOMAIN_OBJECT:
            raise ProtocolError(f"[{head}]: DataType is missing")
        data_type = self._number(keys, "DataType", "0xF", head)
        access = (keys.get("AccessType") or "rw").lower()
        if access not in _ACCESS_TYPES:
            raise ProtocolError(f"[{head}]: AccessType={access}: must be one of {', '.join(sorted(_ACCESS_TYPES))}")
        mappable = keys.get("PDOMapping", "0").lower() in ("1", "0x1", "0x01", "true")
        clean = {"DataType": str(data_type), "AccessType": access, "PDOMapping": str(int(mappable))}
        for key in _VALUE_KEYS & keys.keys():
            if (value := keys[key]) != "" or data_type in (datatypes.VISIBLE_STRING, datatypes.UNICODE_STRING):
                typed = self._typed(keys, key, value, data_type, head)
                clean |= {} if typed is None else {key: typed}
        return clean

    def _number(self, keys: Section, key: str, default: str, head: str) -> int:
        text = keys.get(key) or default
        self._tell_suffix(keys, key, text)
        return integer(text, None, f"[{head}] {key}")

    def _tell_suffix(self, keys: Section, key: str, text: str) -> None:
        if text[-1:] in "LlUu" and any(len(match[2]) > 1 for match in NUMBER.finditer(text.upper())):
            self._repairs.add("a suffix as of C behind a number was left out", keys.line_of(key))

    def _typed(self, keys: Section, key: str, value: str, data_type: int, head: str) -> str | None:
        """Return a value in the library's form: plain integers in the range of their type, negative where the type is signed.

        None for a default that is no number.
        """
        if data_type not in _FIXED_BITS:
            return self._untyped(keys, key, value, data_type)
        if NODE_ID.search(value.upper()) and self._node_id is None:
            return value
        where = f"[{head}] {key}"
        try:
            number = _WORDS.get(value.lower())
            if number is None:
                self._tell_suffix(keys, key, value)
                if hexadecimal := _HEX_WITH_H.fullmatch(value):
                    self._repairs.add("a hexadecimal number begins with 0x, one that ends in h was read as such", keys.line_of(key))
                    value = "0x" + hexadecimal[1].replace(" ", "")
                number = integer(value, self._node_id, where)
        except ProtocolError:
            if key != "DefaultValue":
                raise
            self._repairs.add("a default that is no number was left out", keys.line_of(key))
            return None
        bits = _FIXED_BITS[data_type]
        if not -(1 << (bits - 1)) <= number < 1 << bits:
            if key not in _LIMIT_KEYS:
                raise ProtocolError(f"{where}={value}: does not fit into {bits} bits")
            number = limit_of_type(data_type, bits, upper=key == "HighLimit")
            self._repairs.add(f"{key}={value} is beyond its type and read as {number}", keys.line_of(key))
        if key == "HighLimit" and number < MOST_HEARTBEAT_MS and head.upper().startswith(HEARTBEAT_CONSUMER) and head[7:] != "0":
            number = limit_of_type(data_type, bits, upper=True)
            self._repairs.add(f"{key}={value} leaves a heartbeat consumer no room for a node id, and was left out", keys.line_of(key))
        number &= (1 << bits) - 1
        if data_type in datatypes.SIGNED_TYPES and number >> (bits - 1):
            number -= 1 << bits
        return str(number)

    def _untyped(self, keys: Section, key: str, value: str, data_type: int) -> str | None:
        try:
            return in_librarys_form(value, data_type)
        except (ValueError, OverflowError):
            self._repairs.add(f"{key} is no value of type {data_type:04X}h and was left out", keys.line_of(key))
            return None


def _plain_numbers(keys: dict[str, str], head: str) -> dict[str, str]:
    """Return number-like keys as plain decimals, without empty or unreadable ones of the file's own description."""
    plain = {}
    for key, value in keys.items():
        if key in _TEXT_KEYS:
            plain[key] = value
        elif value:
            try:
                plain[key] = str(integer(value, None, f"[{head}] {key}"))
            except ProtocolError:
                continue  # [DeviceInfo] is for human readers; nothing here depends on it
    return plain
