"""Definitions that both ends of the Modbus line share: function and exception codes, and temperatures in registers.

Source: Modbus Application Protocol Specification V1.1b3, secs. 6 and 7.
"""

from __future__ import annotations

import math
from enum import IntEnum

from drivers.errors import ProtocolError


class FunctionCode(IntEnum):
    """The public functions of an input/output device; the holding register is that of its watchdog."""

    READ_COILS = 0x01
    READ_DISCRETE_INPUTS = 0x02
    READ_HOLDING_REGISTERS = 0x03
    READ_INPUT_REGISTERS = 0x04
    WRITE_SINGLE_COIL = 0x05
    WRITE_SINGLE_REGISTER = 0x06
    WRITE_MULTIPLE_COILS = 0x0F


class ExceptionCode(IntEnum):
    """Reasons for which a device refuses a request."""

    ILLEGAL_FUNCTION = 0x01
    ILLEGAL_DATA_ADDRESS = 0x02
    ILLEGAL_DATA_VALUE = 0x03
    SERVER_DEVICE_FAILURE = 0x04
    ACKNOWLEDGE = 0x05
    SERVER_DEVICE_BUSY = 0x06
    NEGATIVE_ACKNOWLEDGE = 0x07
    MEMORY_PARITY_ERROR = 0x08
    GATEWAY_PATH_UNAVAILABLE = 0x0A
    GATEWAY_TARGET_FAILED_TO_RESPOND = 0x0B


MAX_READ_BITS = 2000
MAX_READ_REGISTERS = 125
MAX_WRITE_BITS = 1968

TEMPERATURE_STEP_K = 0.1
NO_TEMPERATURE = 0x8000  # int16 -32768: sensor broken or not connected


def temperature_to_register(temperature_degC: float) -> int:
    """Return a temperature as int16 in 0.1 degC; NaN as the code for a broken sensor.

    Raises
    ------
    ProtocolError
        The temperature is outside -3276.7 to 3276.7 degC.
    """
    if math.isnan(temperature_degC):
        return NO_TEMPERATURE
    if not abs(temperature_degC) <= 3276.7:
        raise ProtocolError(f"temperature {temperature_degC} degC does not fit a register: at most 3276.7 either way")
    return round(temperature_degC / TEMPERATURE_STEP_K) & 0xFFFF


def register_to_temperature(register: int) -> float:
    """Return the temperature [degC] of a register, the inverse of `temperature_to_register`; NaN for a broken sensor."""
    if register == NO_TEMPERATURE:
        return math.nan
    signed = register - 0x10000 if register & 0x8000 else register
    return signed / 10.0
