"""The emulated detector IMU: a Xsens tracker as seen from its serial line, bytes in and bytes out.

It answers the configuration dialogue, keeps its states (waking, config, measurement) and sends MTData2 messages, triggered by SYNC or on
its own clock. Source: Xsens, MT Low Level Communication Protocol, MT0101P.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

import numpy as np

from drivers.serial.xbus import (
    FORMAT_BITS,
    MAX_RATE,
    NO_SYNC,
    PRECISION_BITS,
    STATUS_FILTER_VALID,
    STATUS_SELF_TEST_PASSED,
    STATUS_SYNC_IN,
    SYNC_FUNCTION_SEND_LATEST,
    SYNC_LINE_IN1,
    DataId,
    ErrorCode,
    Message,
    MessageId,
    Precision,
    Reading,
    StreamParser,
    TIME_TICKS_Hz,
    decode_output_configuration,
    decode_sync_settings,
    encode,
    encode_output_configuration,
    encode_reading,
    encode_sync_settings,
)

OUTPUT_CLOCK_Hz = 32_000  # rates are whole divisions of it: 100, 250, 256, 400, 500, 1000, 2000 Hz and others
MAX_OUTPUT_RATE_Hz = 2000
DEFAULT_RATE_Hz = 100  # after power-on
WAKE_UP_WINDOW_S = 0.5  # how long the device waits for WakeUpAck before it starts measuring

ACCOMPANYING = (DataId.PACKET_COUNTER, DataId.SAMPLE_TIME_FINE, DataId.STATUS_WORD)
INERTIAL = (DataId.ACCELERATION, DataId.RATE_OF_TURN)
FIELDS = dict(zip(Reading._fields, (DataId.PACKET_COUNTER, DataId.SAMPLE_TIME_FINE, *INERTIAL, DataId.STATUS_WORD), strict=True))
"""What a message holds, by the field of a reading."""

NO_SAMPLE = (0.0,) * 6
STATUS_VALID = STATUS_SELF_TEST_PASSED | STATUS_FILTER_VALID


class State(Enum):
    """States of the device."""

    WAKING = "waking"
    CONFIG = "config"
    MEASUREMENT = "measurement"


_WAKING, _CONFIG, _MEASUREMENT = State  # a module's name is looked up faster than a member of an enumeration


def _as_it_is(sample: np.ndarray) -> np.ndarray:
    return sample


class EmulatedImu:
    """A Xsens tracker. Every method that makes it send returns the bytes it puts on the line.

    Parameters
    ----------
    clock_error_ppm : float
        How much faster the device's clock runs than the machine's time.
    product_code, device_id, firmware
        How the device identifies itself.

    Attributes
    ----------
    is_triggered : bool
        Whether SYNC makes it send; else its own clock does.
    reading_of : callable
        What a device on its own clock makes at a SYNC of what is there (6,): noise and rounding, once per message.
    """

    def __init__(
        self,
        *,
        clock_error_ppm: float = 0.0,
        product_code: str = "MTi-100-2A5G4",
        device_id: int = 0x07700001,
        firmware: tuple[int, int, int] = (1, 9, 0),
    ) -> None:
        self._clock_rate = 1.0 + clock_error_ppm * 1e-6
        self._identity = {
            MessageId.REQ_DEVICE_ID: device_id.to_bytes(4, "big"),
            MessageId.REQ_PRODUCT_CODE: product_code.encode("ascii").ljust(20),
            MessageId.REQ_FIRMWARE_REVISION: bytes(firmware),
        }
        self._outputs: list[tuple[int, int]] = [
            *((identifier, MAX_RATE) for identifier in ACCOMPANYING),
            *((identifier, DEFAULT_RATE_Hz) for identifier in INERTIAL),
        ]
        self._sync, self.is_triggered = NO_SYNC, False
        self._time_s = 0.0  # machine time
        self._imu: tuple[float, ...] = ()  # the sample of that time; none yet
        self.reading_of: Callable[[np.ndarray], np.ndarray] = _as_it_is
        self.power_on()

    @property
    def state(self) -> State:
        """The present state of the device."""
        return self._state

    def power_on(self) -> bytes:
        """Start anew: send WakeUp and wait half a second for its acknowledgement.

        Output and sync settings are kept in the device.
        """
        self._state = _WAKING
        self._parser = StreamParser()
        self._started_s = self._time_s
        self._counter = 0
        return encode(MessageId.WAKE_UP)

    def on_sync(self, imu: np.ndarray, time_s: float) -> bytes:
        """Take the rising SYNC line at `time_s` [s].

        `imu` (6,) is the sample: specific force [m/s^2] and angular rate [rad/s] in the sensor's frame. Where the device is triggered it is
        a reading; else it is what is there, of which `reading_of` makes readings.
        """
        due = self.advance(time_s, imu, self.reading_of)
        if self._state is _MEASUREMENT and self.is_triggered:
            pulse = self._pulses - self._sync.skip_first
            self._pulses += 1
            if pulse >= 0 and pulse % (self._sync.skip_factor + 1) == 0:
                return due + self._mtdata2(time_s * self._clock_rate, STATUS_SYNC_IN, self._imu)
        return due

    def advance(self, time_s: float, imu: np.ndarray | None = None, reading_of: Callable[[np.ndarray], np.ndarray] = _as_it_is) -> bytes:
        """Move machine time to `time_s` [s], at which the sample is `imu` (6,); without it, the sample before stands.

        A device on its own clock sends what has become due: each read by `reading_of` on the straight line between the two samples.
        """
        before_s, self._time_s = self._time_s, time_s
        before = self._imu
        if imu is not None:
            self._imu = tuple(imu.tolist())
        if self._state is _WAKING and time_s - self._started_s >= WAKE_UP_WINDOW_S:
            self._measure()
        if self._state is not _MEASUREMENT or self.is_triggered:
            return b""
        sent, now = b"", self._imu or NO_SAMPLE
        while (due := self._measuring_since + (self._sent + 1) / self._rate_Hz) <= time_s * self._clock_rate:
            self._sent += 1
            left = min((time_s - due / self._clock_rate) / (time_s - before_s), 1.0) if time_s > before_s else 0.0
            seen = left * np.array(before or now) + (1.0 - left) * np.array(now) if left > 0.0 else np.array(now)
            sent += self._mtdata2(due, 0, tuple(reading_of(seen).tolist()))
        return sent

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the line and answer the messages that are complete."""
        damaged = self._parser.checksum_errors
        messages = self._parser.feed(data)
        if not messages and self._parser.checksum_errors > damaged:
            return _error(ErrorCode.INVALID_MESSAGE)
        return b"".join(self._answer(message) for message in messages)

    def _measure(self) -> None:
        self._state = _MEASUREMENT
        precision = {identifier & ~FORMAT_BITS: Precision(identifier & PRECISION_BITS) for identifier, _ in self._outputs}
        self._precision = precision.get(DataId.ACCELERATION, Precision.FLOAT32)
        self._left_out = {name: None for name, identifier in FIELDS.items() if identifier not in precision}
        self._rate_Hz = max((rate for identifier, rate in self._outputs if identifier & ~FORMAT_BITS in INERTIAL), default=DEFAULT_RATE_Hz)
        self._measuring_since = self._time_s * self._clock_rate
        self._sent = self._pulses = 0

    def rehearse(self) -> None:
        """Prepare a message without sending it, so that its code and data are at hand."""
        if self._state is _MEASUREMENT:
            counter = self._counter
            self._mtdata2(self._time_s, 0, NO_SAMPLE)
            self._counter = counter

    def _mtdata2(self, device_time_s: float, status: int, imu: tuple[float, ...]) -> bytes:
        """Return one message with the outputs that are configured."""
        time_ticks = int(device_time_s * TIME_TICKS_Hz + 0.5) & 0xFFFFFFFF
        values = self._counter, time_ticks, imu[:3], imu[3:], STATUS_VALID | status
        self._counter = (self._counter + 1) & 0xFFFF
        return encode_reading(Reading(*values)._replace(**self._left_out) if self._left_out else values, self._precision)

    def _answer(self, message: Message) -> bytes:
        command, data = message
        if command == MessageId.WAKE_UP_ACK:
            if self._state is _WAKING:
                self._state = _CONFIG
            return b""
        if command == MessageId.RESET:
            return _acknowledge(command) + self.power_on()
        if command == MessageId.GO_TO_CONFIG:
            self._state = _CONFIG
            return _acknowledge(command)
        if self._state is not _CONFIG:
            return _error(ErrorCode.INVALID_MESSAGE)
        if command == MessageId.GO_TO_MEASUREMENT:
            self._measure()
            return _acknowledge(command)
        if command in self._identity:
            return _acknowledge(command, self._identity[MessageId(command)])
        if command == MessageId.SET_OUTPUT_CONFIGURATION:
            return self._set_outputs(data)
        if command == MessageId.SET_SYNC_SETTINGS:
            return self._set_sync(data)
        return _error(ErrorCode.INVALID_MESSAGE)

    def _set_outputs(self, data: bytes) -> bytes:
        """Grant rates; without data the request only reads them."""
        if len(data) % 4:
            return _error(ErrorCode.INVALID_PARAMETER)
        if data:
            granted = [(identifier, _granted_rate(identifier, rate)) for identifier, rate in decode_output_configuration(data)]
            if any(rate == 0 for _, rate in granted):
                return _error(ErrorCode.INVALID_PARAMETER)
            self._outputs = granted
        return _acknowledge(MessageId.SET_OUTPUT_CONFIGURATION, encode_output_configuration(self._outputs))

    def _set_sync(self, data: bytes) -> bytes:
        """Take one setting or none; without data the request only reads it."""
        if len(data) not in (0, 12):
            return _error(ErrorCode.INVALID_PARAMETER)
        if not data:
            return _acknowledge(MessageId.SET_SYNC_SETTINGS, encode_sync_settings([self._sync]))
        (setting,) = decode_sync_settings(data)
        if setting != NO_SYNC and (setting.function, setting.line) != (SYNC_FUNCTION_SEND_LATEST, SYNC_LINE_IN1):
            return _error(ErrorCode.INVALID_PARAMETER)
        self._sync, self.is_triggered = setting, setting.function == SYNC_FUNCTION_SEND_LATEST
        return _acknowledge(MessageId.SET_SYNC_SETTINGS)


def _acknowledge(command: int, data: bytes = b"") -> bytes:
    return encode(command + 1, data)


def _error(code: ErrorCode) -> bytes:
    return encode(MessageId.ERROR, bytes((code,)))


def _granted_rate(identifier: int, rate: int) -> int:
    """Return the rate that the device gives for `rate` [Hz]; 0 for an output it does not have."""
    kind = identifier & ~FORMAT_BITS
    if kind in ACCOMPANYING:
        return MAX_RATE
    if kind not in INERTIAL:
        return 0
    if rate in (0, MAX_RATE):
        return MAX_OUTPUT_RATE_Hz
    return min(MAX_OUTPUT_RATE_Hz, OUTPUT_CLOCK_Hz // max(1, round(OUTPUT_CLOCK_Hz / rate)))
