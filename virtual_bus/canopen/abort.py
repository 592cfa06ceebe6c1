"""SDO abort codes (CiA 301, table 22): the reasons a device refuses a transfer."""

from __future__ import annotations

TOGGLE_BIT = 0x05030000
TIMED_OUT = 0x05040000
UNKNOWN_COMMAND = 0x05040001
INVALID_BLOCK_SIZE = 0x05040002
INVALID_SEQUENCE_NUMBER = 0x05040003
CRC_ERROR = 0x05040004
OUT_OF_MEMORY = 0x05040005
UNSUPPORTED_ACCESS = 0x06010000
WRITE_ONLY = 0x06010001
READ_ONLY = 0x06010002
NO_OBJECT = 0x06020000
NOT_MAPPABLE = 0x06040041
PDO_LENGTH = 0x06040042
INCOMPATIBLE = 0x06040043
HARDWARE = 0x06060000
TOO_LONG = 0x06070012
TOO_SHORT = 0x06070013
NO_SUBINDEX = 0x06090011
INVALID_VALUE = 0x06090030
VALUE_TOO_HIGH = 0x06090031
VALUE_TOO_LOW = 0x06090032
NOT_STORED = 0x08000020
DEVICE_STATE = 0x08000022
NO_DATA = 0x08000024


class SdoAbortError(Exception):
    """A transfer that the device refuses; `code` goes out on the wire.

    It never leaves this package.
    """

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort {code:08X}h")
        self.code = code
