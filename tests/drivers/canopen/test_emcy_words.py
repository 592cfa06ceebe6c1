"""Emergency messages in words."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.emcy import decode_emergency, describe_code, describe_register

MAXON = 0x0000_00FB  # of the vendor ids that CiA has assigned


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        ("3081110000000000", "EMCY 8130h: life guard or heartbeat error (communication)"),  # CiA 301
        ("1082100000000000", "EMCY 8210h: PDO not processed, length error (communication)"),
        ("1023030000000000", "EMCY 2310h: continuous overcurrent, motor side (current)"),  # CiA 402
        ("1032050000000000", "EMCY 3210h: DC link overvoltage (voltage)"),
        ("1186200000000000", "EMCY 8611h: following error (device profile)"),
        ("0061010000000000", "EMCY 6100h: internal software (generic)"),  # class only
        ("34ff81deadbeef00", "EMCY FF34h: manufacturer specific (manufacturer), vendor bytes de ad be ef 00"),
    ],
)
def test_codes_and_registers_read_as_the_standards_words(frame: str, words: str) -> None:
    assert decode_emergency(bytes.fromhex(frame)).describe() == words


def test_a_maxon_drive_speaks_maxons_words() -> None:
    assert describe_code(0x7390, MAXON) == "missing main sensor"
    assert describe_code(0x7390) == "additional modules"
    assert describe_code(0x8A88, MAXON) == "safe torque off"


def test_all_bits_of_the_error_register_are_named() -> None:
    assert describe_register(0b1011_1110) == "current, voltage, temperature, communication, device profile, manufacturer"
    assert describe_register(0) == ""


@given(st.binary(max_size=8))
def test_any_payload_becomes_one_line(data: bytes) -> None:
    emergency = decode_emergency(data)
    assert emergency.describe().startswith("EMCY ")
    assert "\n" not in emergency.describe()
    assert emergency.is_reset == (len(data) < 2 or data[1] == 0)
