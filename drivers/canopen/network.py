"""A CANopen network without a receiving thread: the code that waits for an answer also receives.

The `canopen` library reads the bus in a separate thread. A second thread in the loop's process costs milliseconds of wake-up time, and an
in-process bus has no other party to wait for. So here the waiting itself takes frames off the bus and hands them to their subscribers.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from functools import partial

import can
import canopen

from drivers.errors import BusError
from drivers.interface import Clock

SEND_PATIENCE_S = 0.002
"""How long a full transmit queue (ENOBUFS) may last: 15 frames at 1 Mbit/s. python-can's own send time-out does not cover this errno."""

QUEUED_FRAMES = 10_000  # more than a receive queue holds; a flood refills it as fast as it is read

HEARTBEAT_PATIENCE = 1.5
"""Periods after which waiting code sends the bench's heartbeat: later than the sample loop would, sooner than a node misses it."""
HEARTBEAT_AWAY = 2.0  # periods from which it was away: no code waits so long with it, and no node bears much more

NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL, NMT_RESET_NODE, NMT_RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82

NMT_STATES = {0x00: "initialising", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}

SDO_REQUEST, SDO_RESPONSE, HEARTBEAT, EMERGENCY = 0x600, 0x580, 0x700, 0x080  # plus node id: predefined connection set


class PolledNetwork(canopen.Network):
    """canopen's network, pumped by the code that waits for an answer.

    Parameters
    ----------
    bus : can.BusABC
        Open bus, which remains the caller's and is not shut down here.
    clock : Clock
        Wall time on a bench, virtual time in lockstep.
    """

    def __init__(self, bus: can.BusABC, clock: Clock) -> None:
        super().__init__(bus)
        self.can_bus = bus
        self.clock = clock
        self.malformed = 0  # frames dropped because they are none of their protocol
        self.first_malformed = ""  # the first of them, in words
        self.passed_over: dict[str, int] = {}  # frames that CANopen gives no meaning here, by what they are
        self.intruder = ""  # who else sends what only the bench or one device may send, in words
        self.heartbeats_sent = 0
        self.sent: dict[int, int] = {}  # frames that `send_message` has sent, by identifier
        self._requests = self._echoes = 0
        self._last_request: tuple[int, bytes] | None = None  # whose echo has not come
        self._heartbeat: can.Message | None = None
        self._heartbeat_patience_s = 0.0
        self._heartbeat_due_s = 0.0
        self._heartbeat_sent_s = self._heartbeat_away_s = self._pause_s = self._pause_ended_s = 0.0
        self.unsubscribe(self.lss.LSS_RX_COBID)  # nobody here asks over LSS, and the library keeps all answers

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send one frame with an 11-bit identifier.

        Raises
        ------
        BusError
            The bus does not take it.
        """
        send_frame(self.can_bus, can.Message(arbitration_id=can_id, is_extended_id=False, data=data, is_remote_frame=remote))
        self._requests += 1
        self.sent[can_id] = self.sent.get(can_id, 0) + 1
        self._last_request = can_id, bytes(data)

    def command_nmt(self, command: int, node_id: int) -> None:
        """Send an NMT command (CiA 301) to one node."""
        self.send_message(0x000, bytes((command, node_id)))

    def pump(self, timeout_s: float) -> bool:
        """Take one frame off the bus and hand it to its subscribers; return False when none came in time.

        Raises
        ------
        BusError
            The bus cannot be read.
        """
        if self._heartbeat is not None and self.clock.now() >= self._heartbeat_due_s:
            self.send_heartbeat()
        message = receive_frame(self.can_bus, timeout_s)
        if message is None:
            return False
        if is_data_frame(message):
            self.hand_on(message)
        else:
            self.pass_over(message)
        return True

    def hand_on(self, message: can.Message) -> None:
        """Hand a data frame to its subscribers, and see whether it is an echo of what was sent last."""
        if self._last_request is not None and self._last_request == (message.arbitration_id, bytes(message.data)):
            self._echoes, self._last_request = self._echoes + 1, None
        self.notify(message.arbitration_id, message.data, message.timestamp)

    @property
    def echoes(self) -> bool:
        """Whether this adapter hands the bench its own frames, which most do not: most of its requests so far came back."""
        return 2 * self._echoes > self._requests

    def accuse(self, words: str) -> None:
        """Name whoever sends what is not theirs to send; the first stays."""
        self.intruder = self.intruder or words

    def drop(self, why: str) -> None:
        """Count a malformed frame that nobody obeys."""
        self.malformed += 1
        self.first_malformed = self.first_malformed or why

    def pass_over(self, message: can.Message) -> None:
        """Count a frame that is no data frame with an 11-bit identifier."""
        kind = (
            "error frames" if message.is_error_frame
            else "frames with a 29-bit identifier" if message.is_extended_id
            else "remote frames" if message.is_remote_frame
            else "CAN FD frames"
        )  # fmt: skip
        self.passed_over[kind] = self.passed_over.get(kind, 0) + 1

    def pump_for(self, duration_s: float) -> None:
        """Receive for this long."""
        deadline = self.clock.now() + duration_s
        while (remaining := deadline - self.clock.now()) > 0.0 and self.pump(remaining):
            pass

    def drain(self) -> None:
        """Receive what has come already, and not more than a flood could bring meanwhile.

        Raises
        ------
        BusError
            The bus cannot be read.
        """
        for _ in range(QUEUED_FRAMES):
            if not self.pump(0.0):
                return

    def start_heartbeat(self, node_id: int, period_s: float) -> None:
        """Start the bench's own heartbeat: the sample loop sends it by tick count, long waits in between by time."""
        self._heartbeat = can.Message(arbitration_id=HEARTBEAT + node_id, is_extended_id=False, data=bytearray(b"\x05"))
        self._heartbeat_patience_s, self._heartbeat_away_s = HEARTBEAT_PATIENCE * period_s, HEARTBEAT_AWAY * period_s
        self._heartbeat_due_s = self._heartbeat_sent_s = self.clock.now()
        self._pause_s = 0.0

    def stop_heartbeat(self) -> None:
        """Stop the bench's heartbeat; nodes that watch it stop their motors."""
        self._heartbeat = None

    def send_heartbeat(self) -> None:
        """Send the bench's heartbeat now, if it is on."""
        if self._heartbeat is not None:
            send_frame(self.can_bus, self._heartbeat)
            self.heartbeats_sent += 1
            now_s = self.clock.now()
            if now_s - self._heartbeat_sent_s > self._heartbeat_away_s:
                self._pause_s, self._pause_ended_s = now_s - self._heartbeat_sent_s, now_s
            self._heartbeat_sent_s, self._heartbeat_due_s = now_s, now_s + self._heartbeat_patience_s

    def pause_of_heartbeat(self, ago_s: float) -> float:
        """Return how long the bench's heartbeat has stayed away, now or until at most so long ago [s]; 0 where it came as it should."""
        now_s = self.clock.now()
        if self._heartbeat is not None and now_s - self._heartbeat_sent_s > self._heartbeat_away_s:
            return now_s - self._heartbeat_sent_s
        return self._pause_s if now_s - self._pause_ended_s <= ago_s else 0.0


def is_data_frame(message: can.Message) -> bool:
    """Return whether this is a data frame with an 11-bit identifier, the only kind that CANopen uses for what is exchanged here."""
    return not (message.is_extended_id or message.is_error_frame or message.is_remote_frame or message.is_fd)


def send_frame(bus: can.BusABC, message: can.Message) -> None:
    """Send a frame; retry while the transmit queue is full for a moment.

    Raises
    ------
    BusError
        The bus does not take the frame.
    """
    try:
        bus.send(message)
    except can.CanError as error:
        _send_again(bus, partial(bus.send, message), message.arbitration_id, error)


def frame_sender(bus: can.BusABC, can_id: int) -> Callable[[bytes], None]:
    """Return what sends data frames with this 11-bit identifier as `send_frame` does, without message objects where the bus can."""
    message = can.Message(arbitration_id=can_id, is_extended_id=False)

    def put_message(can_id: int, data: bytes) -> None:
        message.data, message.dlc = bytearray(data), len(data)
        bus.send(message)

    put: Callable[[int, bytes], None] = getattr(bus, "send_frame", put_message)

    def send(data: bytes) -> None:
        try:
            put(can_id, data)
        except can.CanError as error:
            _send_again(bus, partial(put, can_id, data), can_id, error)

    return send


def _send_again(bus: can.BusABC, send: Callable[[], None], can_id: int, failure: can.CanError) -> None:
    deadline = time.perf_counter() + SEND_PATIENCE_S
    while getattr(failure, "error_code", None) == errno.ENOBUFS or "buffer full" in str(failure):
        if time.perf_counter() > deadline:
            break
        try:
            send()
            return
        except can.CanError as error:
            failure = error
    raise BusError(f"{bus.channel_info}: frame {can_id:03X} could not be sent: {failure}") from failure


def receive_frame(bus: can.BusABC, timeout_s: float) -> can.Message | None:
    """Return the next frame, or None after the time-out.

    Raises
    ------
    BusError
        The bus cannot be read, e.g. because its interface went down.
    """
    try:
        return bus.recv(timeout_s)
    except (can.CanError, OSError) as error:
        raise BusError(f"{bus.channel_info}: cannot be read: {error}") from error
