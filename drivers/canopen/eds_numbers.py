"""Numbers as data sheets write them (CiA 306), and values in the form that the `canopen` library reads."""

from __future__ import annotations

import re
import struct

from canopen.objectdictionary import datatypes

from drivers.errors import ProtocolError

NODE_ID = re.compile(r"\$?\{?NODE[-_ ]?ID\}?")
NUMBER = re.compile(r"([+-]?(?:0X[0-9A-F]+|0B[01]+|[0-9]+))([UL]*)")


def integer(text: str, node_id: int | None, where: str) -> int:
    """Read a CiA 306 number: decimal, hex after 0x, octal after a leading 0, and sums with ``$NODEID``, suffixes as of C left out."""
    total = 0
    for raw in text.replace(" ", "").upper().split("+"):
        if NODE_ID.fullmatch(raw) and node_id is not None:
            total += node_id
            continue
        match = NUMBER.fullmatch(raw)
        if match is None:
            raise ProtocolError(f"{where}={text[:40]}: must be an integer")
        digits = match[1]
        octal = re.fullmatch(r"([+-]?)0([0-7]+)", digits)
        if octal:
            total += int(octal[1] + octal[2], 8)
        else:
            total += int(digits, 10 if digits.lstrip("+-").isdigit() else 0)  # decimals may have leading zeros
    return total


def in_librarys_form(value: str, data_type: int) -> str:
    """Return a value that is no integer as the library reads it; ValueError where it is none of its type."""
    if data_type in datatypes.FLOAT_TYPES:
        if value.lower().startswith("0x"):  # the bits of the number
            size, layout = (4, ">f") if data_type == datatypes.REAL32 else (8, ">d")
            return repr(struct.unpack(layout, int(value, 16).to_bytes(size, "big"))[0])
        return repr(float(value))
    if data_type in (datatypes.OCTET_STRING, datatypes.DOMAIN):
        return bytes.fromhex(re.sub(r"0[xX]|,", " ", value)).hex()
    return value if data_type in (datatypes.VISIBLE_STRING, datatypes.UNICODE_STRING) else str(int(value, 0))


def limit_of_type(data_type: int, bits: int, *, upper: bool) -> int:
    """Return the lowest or highest number of a type."""
    if data_type in datatypes.SIGNED_TYPES:
        return (1 << (bits - 1)) - 1 if upper else -(1 << (bits - 1))
    return (1 << bits) - 1 if upper else 0
