"""Driver of the detector's IMU: configuration dialogue, and one reading per tick without waiting."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.errors import BusUnavailableError, ConfigurationRefusedError, NodeAbsentError, ProtocolError
from drivers.interface import Sample
from drivers.serial.stream import ByteStream
from drivers.serial.xbus import (
    FORMAT_BITS,
    MAX_RATE,
    NO_SYNC,
    STATUS_SELF_TEST_PASSED,
    SYNC_FUNCTION_SEND_LATEST,
    SYNC_LINE_IN1,
    SYNC_RISING_EDGE,
    DataId,
    ErrorCode,
    Message,
    MessageId,
    Reading,
    StreamParser,
    SyncSetting,
    TIME_TICKS_Hz,
    Values,
    decode_output_configuration,
    decode_reading,
    encode,
    encode_output_configuration,
    encode_reading,
    encode_sync_settings,
)
from drivers.settings import ImuPort

NEEDED = ("packet counter (1020h)", "sample time fine (1060h)", "acceleration (4020h)", "rate of turn (8020h)")
"""What every message has to bring, in the order of a `Reading`."""

ANSWER_TIMEOUT_S = 0.5  # the slowest acknowledge, SetOutputConfiguration, writes the device's flash
ANSWER_STEP_S = 0.001
GO_TO_CONFIG_ATTEMPTS = 3  # a device busy streaming, or just powered, may miss the first
BITS_PER_BYTE = 10  # 8N1
COUNTER_MODULO = 1 << 16
TIME_MODULO = 1 << 32

ACCOMPANYING = (DataId.PACKET_COUNTER, DataId.SAMPLE_TIME_FINE)  # sent with every message, whatever its rate
INERTIAL = (DataId.ACCELERATION, DataId.RATE_OF_TURN)
REHEARSED = encode_reading(Reading(0, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0))
SEND_LATEST_ON_SYNC = SyncSetting(
    SYNC_FUNCTION_SEND_LATEST, SYNC_LINE_IN1, SYNC_RISING_EDGE, trigger_once=0, skip_first=0, skip_factor=0, pulse_width=0, delay=0
)


@dataclass(frozen=True)
class ImuIdentity:
    """Identity of the device that answered."""

    device_id: int
    product_code: str
    firmware: str


class ImuDriver:
    """Reads specific force and angular rate from an Xsens tracker.

    Parameters
    ----------
    port : ImuPort
        The machine file's settings.
    stream : ByteStream
        A `SerialStream`, or a pipe to an emulated device.

    Attributes
    ----------
    lost_packets : int
        Packets that never arrived, by the packet counter.
    late_packets : int
        Packets that arrived after the end of their tick, and so are in no row.
    checksum_errors : int
    malformed : int
        Messages with a right checksum whose content is no reading.
    first_malformed : str
        Why the first of them was none.
    """

    def __init__(self, port: ImuPort, stream: ByteStream) -> None:
        self.port = port
        self.identity: ImuIdentity | None = None
        self.lost_packets = 0
        self.late_packets = 0
        self.malformed = 0
        self.first_malformed = ""
        self._stream = stream
        self._parser = StreamParser()
        self._rehearsal = StreamParser()
        self._line = f"imu {port.name!r}" + (f" on {port.device}" if port.device else "")
        self._counter = -1  # unwrapped
        self._time_ticks = -1  # unwrapped
        self._gone = False
        self._fault = ""  # the first since it was configured

    @property
    def checksum_errors(self) -> int:
        """Number of damaged messages."""
        return self._parser.checksum_errors

    def configure(self, wait: Callable[[float], None] = time.sleep) -> ImuIdentity:
        """Identify the device, configure what it sends and when, and start it. Every step is acknowledged.

        Parameters
        ----------
        wait : callable
            Lets seconds pass: `Clock.wait`.

        Raises
        ------
        NodeAbsentError
            The device does not answer.
        ConfigurationRefusedError
            The device reports an error, or grants something else than was asked.
        ProtocolError
            An answer has the wrong size.
        """
        self._go_to_config(wait)
        self.identity = self._identify(wait)
        self._set_output(wait)
        sync = SEND_LATEST_ON_SYNC if self.port.triggered_by_sync else NO_SYNC
        self._ask(MessageId.SET_SYNC_SETTINGS, encode_sync_settings([sync]), wait)
        self._ask(MessageId.GO_TO_MEASUREMENT, b"", wait)
        self._counter = self._time_ticks = -1
        self._fault = ""
        self.lost_packets = self.late_packets = self.malformed = 0
        self.first_malformed = ""
        return self.identity

    def before_sync(self) -> None:
        """Drop what is still in the line, which answers an earlier SYNC; call this right before a SYNC goes out."""
        if self.port.triggered_by_sync:
            for reading in self._receive():
                self._count(reading)
                self.late_packets += 1

    def rehearse(self) -> None:
        """Decode a stored message shortly before a real one, so that the real one is decoded faster."""
        self._rehearsal.whole_reading(REHEARSED)
        for message in self._rehearsal.feed(REHEARSED):  # in pieces, as it may come on a real line
            decode_reading(message.data)

    def poll(self, sample: Sample) -> bool:
        """Copy the newest reading since the last call into `sample`; NaN and -1 when there is none. Never waits.

        After a device error, a failed self-test or the loss of the port, `sample.imu_fault` holds the reason.

        Returns
        -------
        bool
            Whether there was a reading.
        """
        newest = None
        for reading in self._receive():
            if newest is not None and self.port.triggered_by_sync:
                self.late_packets += 1
            newest = reading
            self._count(reading)
        if newest is not None and newest[4] is not None and not newest[4] & STATUS_SELF_TEST_PASSED:
            self._report("reports a failed self-test")
        sample.imu_fault = self._fault
        sample.imu_damaged = self._parser.checksum_errors
        if newest is None:
            sample.imu.fill(np.nan)
            sample.imu_time_s = float("nan")
            sample.imu_counter = -1
            return False
        _, _, acceleration, rate_of_turn, _ = newest
        assert acceleration is not None
        assert rate_of_turn is not None
        imu = sample.imu
        imu[0], imu[1], imu[2] = acceleration  # one by one: numbers cost less than slices
        imu[3], imu[4], imu[5] = rate_of_turn
        sample.imu_time_s = self._time_ticks / TIME_TICKS_Hz
        sample.imu_counter = self._counter
        return True

    def _receive(self) -> Sequence[Values]:
        """Return the complete readings that have arrived."""
        try:
            data = self._stream.read()
        except BusUnavailableError as error:
            if not self._gone:
                self._gone = True
                self._report(str(error))
            return ()
        if not data:
            return ()
        if (reading := self._parser.whole_reading(data)) is not None:
            return (reading,)
        return self._readings_in(self._parser.feed(data))

    def _readings_in(self, messages: list[Message]) -> list[Reading]:
        """Return the complete readings among messages, and keep what the others say."""
        readings = []
        for message in messages:
            if message.message_id == MessageId.MTDATA2:
                try:
                    reading = decode_reading(message.data)
                except ProtocolError as error:
                    self._drop(str(error))
                    continue
                if None in reading[:4]:
                    self._drop(f"without {', '.join(what for what, field in zip(NEEDED, reading, strict=False) if field is None)}")
                else:
                    readings.append(reading)
            elif message.message_id == MessageId.ERROR:
                self._report(f"reports {_error_in_words(message.data)}")
            elif message.message_id == MessageId.WAKE_UP:
                self._report("has started anew: its configuration is lost")
        return readings

    def _drop(self, why: str) -> None:
        """Count a message that is no reading, and keep why the first was none."""
        self.malformed += 1
        self.first_malformed = self.first_malformed or why

    def _report(self, fault: str) -> None:
        self._fault = self._fault or f"{self._line}: {fault}"

    def _count(self, reading: Values) -> None:
        """Unwrap the packet counter and the sample time."""
        counter, time_ticks, _, _, _ = reading
        assert counter is not None
        assert time_ticks is not None
        if self._counter < 0:
            self._counter, self._time_ticks = counter, time_ticks
            return
        step = (counter - self._counter) % COUNTER_MODULO
        if step > 1:
            self.lost_packets += step - 1
        self._counter += step
        self._time_ticks += (time_ticks - self._time_ticks) % TIME_MODULO

    def _go_to_config(self, wait: Callable[[float], None]) -> None:
        self._stream.read()  # old data
        for attempt in range(GO_TO_CONFIG_ATTEMPTS):
            try:
                self._ask(MessageId.GO_TO_CONFIG, b"", wait)
                return
            except (NodeAbsentError, ConfigurationRefusedError):  # bytes left over from before may have drawn an error
                if attempt == GO_TO_CONFIG_ATTEMPTS - 1:
                    raise

    def _identify(self, wait: Callable[[float], None]) -> ImuIdentity:
        device_id = self._ask(MessageId.REQ_DEVICE_ID, b"", wait)
        product_code = self._ask(MessageId.REQ_PRODUCT_CODE, b"", wait)
        firmware = self._ask(MessageId.REQ_FIRMWARE_REVISION, b"", wait)
        if len(device_id) not in (4, 8) or len(firmware) < 3:
            raise ProtocolError(
                f"{self._line}: a device id of {len(device_id)} bytes and a firmware revision of {len(firmware)}, where a motion"
                " tracker has 4 or 8 and 3"
            )
        return ImuIdentity(
            device_id=int.from_bytes(device_id, "big"),
            product_code=product_code.decode("ascii", "replace").strip(" \0"),
            firmware=".".join(str(byte) for byte in firmware[:3]),
        )

    def _set_output(self, wait: Callable[[float], None]) -> None:
        """Request counter, time, specific force, rate of turn and status; check what was granted."""
        rate = MAX_RATE if self.port.triggered_by_sync else round(self.port.rate_Hz)
        wanted: list[tuple[int, int]] = [(identifier, MAX_RATE) for identifier in ACCOMPANYING]
        wanted += [(identifier, rate) for identifier in INERTIAL]
        wanted.append((DataId.STATUS_WORD, MAX_RATE))
        message_bytes = len(REHEARSED)
        needed_baud = message_bytes * BITS_PER_BYTE * self.port.rate_Hz
        if needed_baud > self.port.baud:
            raise ConfigurationRefusedError(
                f"{self._line}: {message_bytes} bytes at {self.port.rate_Hz:g} Hz need more than {needed_baud:.0f} baud,"
                f" the port runs at {self.port.baud}"
            )
        granted = decode_output_configuration(self._ask(MessageId.SET_OUTPUT_CONFIGURATION, encode_output_configuration(wanted), wait))
        if [identifier & ~FORMAT_BITS for identifier, _ in granted] != [identifier for identifier, _ in wanted]:
            listed = ", ".join(f"0x{identifier:04X}" for identifier, _ in granted)
            raise ConfigurationRefusedError(
                f"{self._line}: grants the outputs {listed}; counter, time, acceleration, rate of turn and status are needed"
            )
        rates = {identifier & ~FORMAT_BITS: rate for identifier, rate in granted}
        for identifier in INERTIAL:
            fits = rates[identifier] >= self.port.rate_Hz if self.port.triggered_by_sync else rates[identifier] == rate
            if not fits:
                raise ConfigurationRefusedError(
                    f"{self._line}: grants {rates[identifier]} Hz where rate_Hz = {self.port.rate_Hz:g}; choose a rate the device has"
                )

    def _ask(self, command: MessageId, data: bytes, wait: Callable[[float], None]) -> bytes:
        """Send a command and return the data of its acknowledge; measurement data in between are dropped."""
        self._stream.write(encode(command, data))
        came, others = 0, set[int]()
        steps = round(ANSWER_TIMEOUT_S / ANSWER_STEP_S)
        for step in range(steps + 1):
            last = step == steps  # then the answer may be stuck behind a message that was cut off
            heard = b"" if last else self._stream.read()
            came += len(heard)
            for message in self._parser.give_up() if last else self._parser.feed(heard):
                if message.message_id == command + 1:
                    return message.data
                self._check_refusal(command, message)
                others.add(message.message_id)
            if not last:
                wait(ANSWER_STEP_S)
        raise NodeAbsentError(f"{self._line}: no answer to {command.name} within {ANSWER_TIMEOUT_S:g} s; {self._what_came(came, others)}")

    def _what_came(self, came: int, others: set[int]) -> str:
        """Return what stood where an answer belongs, and what to check there."""
        if others:  # a message with a right checksum: the line runs at the device's rate
            return f"messages {', '.join(f'{one:02X}h' for one in sorted(others))} came; check the line towards the device"
        rate = "the device server's baud rate" if self.port.device.startswith("tcp:") else f"the machine file's baud = {self.port.baud}"
        if came:
            return f"{came} bytes came that are no Xbus message; check {rate} and what is on this line"
        return f"check power, cable and {rate}"

    def _check_refusal(self, command: MessageId, message: Message) -> None:
        if message.message_id == MessageId.ERROR:
            raise ConfigurationRefusedError(f"{self._line}: answers {command.name} with {_error_in_words(message.data)}")


def _error_in_words(data: bytes) -> str:
    code = data[0] if data else 0
    try:
        return f"error 0x{code:02X} ({ErrorCode(code).name.lower().replace('_', ' ')})"
    except ValueError:
        return f"error 0x{code:02X}"
