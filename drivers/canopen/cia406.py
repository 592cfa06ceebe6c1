"""Absolute encoders, CiA 406: position value and alarms."""

from __future__ import annotations

from drivers.canopen.emcy import describe_code
from drivers.canopen.sdo import SdoNode
from drivers.errors import DeviceFaultError

ALARMS, SUPPORTED_ALARMS = 0x6503, 0x6504
ALARM_BITS = {0: "position error", 1: "commissioning diagnostic control failed"}

_HALF_RANGE, _RANGE = 1 << 31, 1 << 32


def signed_counts(raw: int, zero: int) -> int:
    """Return counts from the joint's zero, for a 32-bit position value (6004h) that may have wrapped."""
    return (raw - zero + _HALF_RANGE) % _RANGE - _HALF_RANGE


def check_alarms(node: SdoNode) -> None:
    """Refuse an encoder that reports its position as wrong.

    Raises
    ------
    DeviceFaultError
        The encoder has an alarm; the message gives each in words.
    """
    if not node.knows(ALARMS):
        return
    alarms = int.from_bytes(node.read_if_present(ALARMS) or b"", "little")
    if alarms:
        words = [ALARM_BITS.get(bit, f"manufacturer's alarm {bit}") for bit in range(16) if alarms >> bit & 1]
        error = int.from_bytes(node.read_if_present(0x603F) or b"", "little")
        raise DeviceFaultError(f"{node.who}: encoder alarm: {', '.join(words)}{f'; {describe_code(error)}' if error else ''}")
