"""The CAN identifiers that a COB-ID object may hold (CiA 301, table 41: restricted CAN-IDs)."""

from __future__ import annotations

from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError

INVALID = 1 << 31  # bit 31: the object or PDO does not exist
NO_RTR = 1 << 30  # TPDO: no RTR allowed; SYNC: the device generates SYNC
EXTENDED = 1 << 29
CAN_ID = 0x7FF
SYNC = 0x080  # where a device has no object that says another

_RESTRICTED = (
    (0x000, 0x07F),  # NMT, global fail-safe, reserved
    (0x101, 0x180),  # reserved
    (0x581, 0x5FF),  # default SDO, server to client
    (0x601, 0x67F),  # default SDO, client to server
    (0x6E0, 0x6FF),  # reserved
    (0x701, 0x77F),  # NMT error control
    (0x780, 0x7FF),  # reserved
)


def is_restricted(can_id: int) -> bool:
    """Return whether no configurable object may use this identifier."""
    return any(low <= can_id <= high for low, high in _RESTRICTED)


def check_change(old: int, new: int, *, exists: bool) -> None:
    """Refuse a COB-ID that may not become `new`.

    `exists` says whether the object of `old` is alive: then only its bits 30 and 31 may change.

    Raises
    ------
    SdoAbortError
        The identifier has 29 bits, is restricted, or may not change.
    """
    if new & EXTENDED or new & 0x1FFF_F800:
        raise SdoAbortError(abort.INVALID_VALUE)  # 29-bit identifiers are not supported
    if new & INVALID:
        return
    if is_restricted(new & CAN_ID) or (exists and (new ^ old) & CAN_ID):
        raise SdoAbortError(abort.INVALID_VALUE)
