"""Emergency messages (EMCY) in words: CiA 301 classes, CiA 402 codes, and the maxon EPOS4's own.

Sources: CiA 301 tables 26 (error code classes) and 48 (error register); CiA 402-2 error codes (IEC 61800-7-201); maxon EPOS4 Firmware
Specification, chapter "Device errors".
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

MAXON_VENDOR_ID = 0x000000FB
_LAYOUT = struct.Struct("<HB5s")
CODE_BYTES = 2  # without its error code a frame says nothing

# error register, object 1001h, CiA 301
REGISTER_BITS = ("generic", "current", "voltage", "temperature", "communication", "device profile", "reserved", "manufacturer")

# (code, mask, words): the classes of CiA 301, the widest mask last
CLASSES = (
    (0x1000, 0xFF00, "generic error"),
    (0x2100, 0xFF00, "current, device input side"),
    (0x2200, 0xFF00, "current inside the device"),
    (0x2300, 0xFF00, "current, device output side"),
    (0x2000, 0xF000, "current"),
    (0x3100, 0xFF00, "mains voltage"),
    (0x3200, 0xFF00, "voltage inside the device"),
    (0x3300, 0xFF00, "output voltage"),
    (0x3000, 0xF000, "voltage"),
    (0x4100, 0xFF00, "ambient temperature"),
    (0x4200, 0xFF00, "device temperature"),
    (0x4300, 0xFF00, "drive temperature"),
    (0x4000, 0xF000, "temperature"),
    (0x5000, 0xF000, "device hardware"),
    (0x6100, 0xFF00, "internal software"),
    (0x6200, 0xFF00, "user software"),
    (0x6300, 0xFF00, "data set"),
    (0x6000, 0xF000, "device software"),
    (0x7000, 0xF000, "additional modules"),
    (0x8100, 0xFF00, "communication"),
    (0x8200, 0xFF00, "protocol error"),
    (0x8000, 0xF000, "monitoring"),
    (0x9000, 0xF000, "external error"),
    (0xF000, 0xFF00, "additional functions"),
    (0xFF00, 0xFF00, "manufacturer specific"),
)

# exact codes: CiA 301 communication errors, then CiA 402 drives
CODES = {
    0x8110: "CAN overrun, objects lost",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat error",
    0x8140: "recovered from bus off",
    0x8150: "CAN-ID collision",
    0x8210: "PDO not processed, length error",
    0x8220: "PDO length exceeded",
    0x8230: "DAM MPDO not processed, destination object not available",
    0x8240: "unexpected SYNC data length",
    0x8250: "RPDO time-out",
    0x2110: "short circuit or earth leakage, input",
    0x2120: "earth leakage, input",
    0x2130: "short circuit, input",
    0x2211: "overcurrent inside the device, no. 1",
    0x2212: "overcurrent inside the device, no. 2",
    0x2213: "overcurrent in ramp function",
    0x2214: "overcurrent in the sequence",
    0x2220: "continuous overcurrent inside the device",
    0x2230: "short circuit or earth leakage inside the device",
    0x2240: "earth leakage inside the device",
    0x2250: "short circuit inside the device",
    0x2310: "continuous overcurrent, motor side",
    0x2320: "short circuit or earth leakage, motor side",
    0x2330: "earth leakage, motor side",
    0x2340: "short circuit, motor side",
    0x2350: "load level fault, I2t, thermal state",
    0x3110: "mains overvoltage",
    0x3120: "mains undervoltage",
    0x3130: "phase failure",
    0x3210: "DC link overvoltage",
    0x3220: "DC link undervoltage",
    0x3310: "output overvoltage",
    0x3331: "field circuit interrupted",
    0x4110: "excess ambient temperature",
    0x4210: "excess device temperature",
    0x4310: "excess drive temperature",
    0x5112: "supply +24 V low",
    0x5113: "supply +5 V low",
    0x5200: "control",
    0x5300: "operating unit",
    0x5400: "power section",
    0x5430: "input stages",
    0x5440: "contactors",
    0x5441: "enable or safety contact 1",
    0x5510: "working memory",
    0x5530: "non-volatile data memory",
    0x6010: "software reset, watchdog",
    0x6310: "loss of parameters",
    0x6320: "parameter error",
    0x7110: "brake chopper",
    0x7121: "motor blocked",
    0x7122: "motor error or commutation malfunction",
    0x7300: "sensor",
    0x7303: "resolver 1 fault",
    0x7305: "incremental sensor 1 fault",
    0x7310: "speed",
    0x7320: "position",
    0x7500: "communication module",
    0x8300: "torque control",
    0x8311: "excess torque",
    0x8331: "torque fault",
    0x8400: "velocity speed controller",
    0x8500: "position controller",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "SYNC controller",
    0x8800: "winding controller",
    0x8900: "process data monitoring",
    0x8A00: "control monitoring",
    0xF001: "deceleration",
    0xF002: "sub-synchronous run",
    0xF004: "control monitoring",
}

MAXON_CODES = {
    0x1000: "generic error",
    0x1090: "firmware incompatibility",
    0x2310: "overcurrent",
    0x2320: "power stage protection",
    0x3210: "overvoltage",
    0x3220: "undervoltage",
    0x4210: "thermal overload",
    0x4380: "thermal motor overload",
    0x5113: "logic supply voltage too low",
    0x5280: "hardware defect",
    0x5281: "hardware incompatibility",
    0x6080: "sign of life",
    0x6081: "extension 1 watchdog",
    0x6320: "software parameter",
    0x6380: "persistent parameters corrupt",
    0x7320: "position sensor",
    0x7380: "position sensor breach",
    0x7381: "position sensor resolution",
    0x7382: "position sensor index",
    0x7388: "Hall sensor",
    0x7389: "Hall sensor not found",
    0x738A: "Hall angle detection",
    0x738C: "SSI sensor",
    0x738D: "SSI sensor frame",
    0x7390: "missing main sensor",
    0x7391: "missing commutation sensor",
    0x7392: "main sensor direction",
    0x8110: "CAN overrun, object lost",
    0x8111: "CAN overrun",
    0x8120: "CAN passive mode",
    0x8130: "CAN heartbeat error",
    0x8150: "CAN PDO COB-ID collision",
    0x81FD: "CAN bus turned off",
    0x81FE: "CAN receive queue overflow",
    0x81FF: "CAN transmit queue overflow",
    0x8210: "CAN PDO length",
    0x8250: "RPDO time-out",
    0x8611: "following error",
    0x8A80: "negative limit switch",
    0x8A81: "positive limit switch",
    0x8A82: "software position limit",
    0x8A88: "safe torque off",
    0xFF01: "system overloaded",
    0xFF02: "watchdog",
    0xFF0B: "system peak overloaded",
    0xFF10: "controller gain",
    0xFF11: "auto tuning identification",
    0xFF12: "auto tuning current limit",
    0xFF13: "auto tuning identification current",
    0xFF14: "auto tuning data collection",
    0xFF15: "auto tuning sample mismatch",
    0xFF16: "auto tuning parameter",
    0xFF17: "auto tuning amplitude mismatch",
    0xFF19: "auto tuning time-out",
    0xFF20: "auto tuning standstill",
    0xFF21: "auto tuning torque invalid",
}


@dataclass(frozen=True)
class Emergency:
    """One EMCY message."""

    code: int
    register: int
    vendor_bytes: bytes  # (5,)

    @property
    def is_reset(self) -> bool:
        """Whether the code is of class 00xxh: the error is gone."""
        return self.code & 0xFF00 == 0

    def describe(self, vendor_id: int | None = None) -> str:
        """Return the message in words, e.g. `EMCY 8130h: life guard or heartbeat error (communication)`."""
        vendor = f", vendor bytes {self.vendor_bytes.hex(' ')}" if any(self.vendor_bytes) else ""
        register = describe_register(self.register)
        return f"EMCY {self.code:04X}h: {describe_code(self.code, vendor_id)}{f' ({register})' if register else ''}{vendor}"


def decode_emergency(data: bytes | bytearray) -> Emergency:
    """Read the payload of an EMCY frame; short frames, which some devices send, are filled with zeros."""
    return Emergency(*_LAYOUT.unpack(bytes(data[:8]).ljust(8, b"\0")))


def describe_code(code: int, vendor_id: int | None = None) -> str:
    """Return an error code (EMCY or object 603Fh) in words; vendor tables go first when the vendor is known."""
    if code & 0xFF00 == 0:
        return "no error"
    if vendor_id == MAXON_VENDOR_ID and code in MAXON_CODES:
        return MAXON_CODES[code]
    if code in CODES:
        return CODES[code]
    for value, mask, words in CLASSES:
        if code & mask == value:
            return words
    return "unknown error code"


def describe_register(register: int) -> str:
    """Return the bits of the error register 1001h in words, without the generic bit when another says more."""
    words = [name for bit, name in enumerate(REGISTER_BITS) if register >> bit & 1]
    return ", ".join(words[1:] if len(words) > 1 and words[0] == "generic" else words)
