"""Access to the objects of one node over SDO: typed by the data sheet, verified by read-back, every failure in words."""

from __future__ import annotations

import struct
from collections import deque
from math import inf

import canopen
from canopen.objectdictionary import datatypes
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.canopen.network import SDO_REQUEST, SDO_RESPONSE, PolledNetwork
from drivers.errors import ConfigurationRefusedError, DuplicateNodeError, NodeAbsentError

RESPONSE_TIMEOUT_S = 0.3  # CiA 301 gives none; EPOS4 answers within 20 ms, writes to its flash within 200 ms
SHORTEST_ANSWER = 4  # CiA 301 asks for 8 bytes; some devices leave out data bytes that are zero
TRIES = 3  # of a request that starts a transfer; segments are not repeated, their toggle bit would differ
LATE_ANSWER_S = TRIES * RESPONSE_TIMEOUT_S
"""How long the answer to a request that was given up may still come, and is no second device's."""
MOST_SEGMENTS = 9363  # 64 kB; what is read here are numbers and names
ABORT_TIMED_OUT = 0x0504_0000
ABSENT_OBJECT = frozenset({0x0602_0000, 0x0609_0011})  # no such object, no such subindex
_ANSWERS = {0x20: 0x60, 0x40: 0x40}
"""Command specifiers (bits 7..5) of initiate download and initiate upload, and of their answers."""
_READS, _ABORTS = 0x40, 0x80

Address = tuple[int, int]


class SdoSilenceError(SdoCommunicationError):
    """A node answered nothing in time."""


class PolledSdoClient(SdoClient):
    """canopen's SDO client with two changes: its waiting pumps the network, and a second answer to one request is detected."""

    network: PolledNetwork

    def __init__(self, network: PolledNetwork, node_id: int, dictionary: canopen.ObjectDictionary, who: str) -> None:
        super().__init__(SDO_REQUEST + node_id, SDO_RESPONSE + node_id, dictionary)  # type: ignore[no-untyped-call]
        self.network = network
        self._who = who
        self._answers: deque[bytes] = deque()
        self._answers_owed = 0
        self._late: list[tuple[float, bytes]] = []  # requests that were given up: until when their answers may come, and their multiplexers
        self._asked: Address | None = None  # a question whose answer nobody waits for
        self._asked_s = 0.0
        self._segments = 0  # of the transfer under way
        self.fastest_read_s = inf  # from the first request to its answer
        network.subscribe(self.tx_cobid, self.on_response)

    def close(self) -> None:
        """Stop receiving answers."""
        self.network.unsubscribe(self.tx_cobid, self.on_response)

    def on_response(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Keep an answer until it is read; one without a whole multiplexer or of no SDO's length is dropped."""
        if not SHORTEST_ANSWER <= len(data) <= 8:
            self.network.drop(f"{self._who}: an SDO answer of {len(data)} bytes")
            return
        self._answers.append(bytes(data).ljust(8, b"\0"))

    def read_response(self) -> bytes:
        """Wait for an answer; library errors as in the base class."""
        clock = self.network.clock
        deadline = clock.now() + RESPONSE_TIMEOUT_S
        while not self._answers:
            remaining = deadline - clock.now()
            if remaining <= 0.0 or not self.network.pump(remaining):
                raise SdoSilenceError(f"no SDO answer within {RESPONSE_TIMEOUT_S} s")
        response = self._answers.popleft()
        self._answers_owed -= 1
        if response[0] == 0x80:
            raise SdoAbortedError(struct.unpack_from("<I", response, 4)[0])
        return response

    def request_response(self, sdo_request: bytes) -> bytes:
        """Send a request and wait for its answer; a lost frame is handled by asking again."""
        self._expect_silence()
        initiates = sdo_request[0] & 0xE0 in _ANSWERS
        self._segments = 0 if initiates else self._segments + 1
        if self._segments > MOST_SEGMENTS:
            self.abort()
            raise SdoCommunicationError(f"the node sends more than {MOST_SEGMENTS} segments without an end")
        tries, began_s = TRIES if initiates else 1, self.network.clock.now()
        for _ in range(tries):
            self._answers_owed += 1
            self.send_request(sdo_request)  # type: ignore[no-untyped-call]
            try:
                answer = self._answer_to(sdo_request) if initiates else self.read_response()
            except SdoCommunicationError:
                self._give_up(sdo_request)
                continue
            if sdo_request[0] & 0xE0 == _READS:
                self.fastest_read_s = min(self.fastest_read_s, self.network.clock.now() - began_s)
            return answer
        self.abort(ABORT_TIMED_OUT)
        raise SdoSilenceError(f"no SDO answer within {RESPONSE_TIMEOUT_S} s, asked {tries} times")

    def _answer_to(self, request: bytes) -> bytes:
        """Wait for the answer to a request that starts a transfer; late ones, to requests that were given up, are passed over."""
        clock = self.network.clock
        deadline = clock.now() + RESPONSE_TIMEOUT_S
        while (remaining := deadline - clock.now()) > 0.0 and (self._answers or self.network.pump(remaining)):
            if self._answers and not self._passes_over(self._answers[0], request):
                return self.read_response()
        raise SdoSilenceError(f"no SDO answer within {RESPONSE_TIMEOUT_S} s")

    def _passes_over(self, answer: bytes, request: bytes) -> bool:
        """Drop the oldest answer if it is a late one to an earlier request; return whether it was."""
        fits = answer[0] & 0xE0 in (_ANSWERS[request[0] & 0xE0], _ABORTS) and answer[1:4] == request[1:4]
        if fits or not self._take_late(answer):
            return False
        self._answers.popleft()
        return True

    def _give_up(self, request: bytes) -> None:
        self._answers_owed -= 1
        self._late.append((self.network.clock.now() + LATE_ANSWER_S, bytes(request[1:4])))

    def _take_late(self, answer: bytes) -> bool:
        """Return whether an answer is that to a request which was given up, and expect it no more."""
        now_s = self.network.clock.now()
        self._late = [each for each in self._late if each[0] >= now_s]
        for each in self._late:
            if each[1] == answer[1:4]:
                self._late.remove(each)
                return True
        return False

    def abort(self, abort_code: int = 0x0800_0000) -> None:
        """Tell the server that this transfer is over."""
        self.send_request(struct.pack("<BHBI", 0x80, 0, 0, abort_code))  # type: ignore[no-untyped-call]

    def ask(self, index: int, subindex: int) -> None:
        """Ask for the value of an object without waiting for it; `answer` has it later."""
        self._asked, self._asked_s = (index, subindex), self.network.clock.now()
        self._answers_owed += 1
        self.send_request(struct.pack("<BHB4x", 0x40, index, subindex))  # type: ignore[no-untyped-call]

    def answer(self) -> bytes | None:
        """Return the frame that answers `ask`, b"" where none came in time or somebody else's transfer took its place, None: not yet."""
        if self._asked is None:
            return b""
        multiplexer = struct.pack("<HB", *self._asked)
        while self._answers:
            response = self._answers.popleft()
            self._answers_owed -= 1
            if response[1:4] == multiplexer:
                self._asked = None
                return response
        if self.network.clock.now() - self._asked_s > RESPONSE_TIMEOUT_S:
            self._give_up(b"\0" + multiplexer)
            self._asked = None
            return b""
        return None

    def owe_another(self) -> None:
        """Expect an answer to a request that somebody else has sent."""
        self._answers_owed += 1

    def write_unheard(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object of up to four bytes and do not wait for the answer."""
        self._answers_owed += 1
        command = 0x23 | 4 - len(data) << 2
        self.send_request(struct.pack("<BHB", command, index, subindex) + data.ljust(4, b"\0"))  # type: ignore[no-untyped-call]

    def _expect_silence(self) -> None:
        while self.answer() is None and self.network.pump(RESPONSE_TIMEOUT_S):
            pass
        self._asked = None
        self.network.drain()
        twice = sum(not self._take_late(answer) for answer in self._answers) > max(0, self._answers_owed)
        self._answers.clear()
        self._answers_owed = 0
        if twice:
            raise DuplicateNodeError(
                f"{self._who}: two answers to one SDO request: two devices share this id; give one of them another (switches or LSS)"
            )


class SdoNode:
    """The object dictionary of one remote node.

    Parameters
    ----------
    network : PolledNetwork
    node_id : int
    name : str
        Name in the machine file; precedes every error message.
    dictionary : canopen.ObjectDictionary, optional
        From the node's EDS; without one, integers are unsigned and as long as the device sends them.
    """

    def __init__(self, network: PolledNetwork, node_id: int, name: str, dictionary: canopen.ObjectDictionary | None = None) -> None:
        self.network = network
        self.node_id = node_id
        self.who = f"{name} (node {node_id})" if name else f"node {node_id}"
        self.dictionary = dictionary if dictionary is not None else canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
        self._client = PolledSdoClient(network, node_id, self.dictionary, self.who)
        self.settings: dict[Address, tuple[int, int]] = {}
        """What each object should hold that was written, and the bits of it that do not matter."""
        self.ask, self.answer, self.owe_another = self._client.ask, self._client.answer, self._client.owe_another

    @property
    def fastest_read_s(self) -> float:
        """How long the fastest answer to a read took; infinite before the first."""
        return self._client.fastest_read_s

    def close(self) -> None:
        """Stop listening for this node's answers."""
        self._client.close()

    def knows(self, index: int, subindex: int = 0) -> bool:
        """Return whether the data sheet has this object."""
        return self.dictionary.get_variable(index, subindex) is not None

    def may_write(self, index: int, subindex: int = 0) -> bool:
        """Return whether the data sheet has this object and allows writing it."""
        variable = self.dictionary.get_variable(index, subindex)
        return variable is not None and variable.writable

    def greatest(self, index: int, subindex: int = 0) -> int | None:
        """Return the greatest value that the data sheet allows an object; None where it says none."""
        variable = self.dictionary.get_variable(index, subindex)
        return None if variable is None else variable.max

    def read(self, index: int, subindex: int = 0) -> bytes:
        """Read the raw value of an object.

        Raises
        ------
        ConfigurationRefusedError
            The node aborted; the message gives the abort code in words.
        NodeAbsentError
            It does not answer.
        """
        try:
            return bytes(self._client.upload(index, subindex))
        except SdoAbortedError as error:
            raise ConfigurationRefusedError(
                f"{self.who}: reading {self.named(index, subindex)} refused: {abort_in_words(error)}"
            ) from error
        except SdoCommunicationError as error:
            raise NodeAbsentError(f"{self.who}: reading {self.named(index, subindex)}: {error}; is it powered and on this bus?") from error

    def read_if_present(self, index: int, subindex: int = 0) -> bytes | None:
        """Read the raw value, or return None when the node has no such object."""
        try:
            return self.read(index, subindex)
        except ConfigurationRefusedError as error:
            if isinstance(error.__cause__, SdoAbortedError) and error.__cause__.code in ABSENT_OBJECT:
                return None
            raise

    def read_integer(self, index: int, subindex: int = 0) -> int:
        """Read the value of an integer object, signed where the data sheet says so."""
        return self.to_integer(index, subindex, self.read(index, subindex))

    def integer_if_present(self, index: int, subindex: int = 0) -> int | None:
        """Read the same, or return None where data sheet or node have no such object."""
        data = self.read_if_present(index, subindex) if self.knows(index, subindex) else None
        return None if data is None else self.to_integer(index, subindex, data)

    def integer_if_there(self, index: int, subindex: int = 0) -> int | None:
        """Read an unsigned integer whether or not the data sheet has it, or return None where the node refuses."""
        if self.knows(index, subindex):
            return self.integer_if_present(index, subindex)
        try:
            return int.from_bytes(self.read(index, subindex), "little")
        except ConfigurationRefusedError:
            return None

    def read_text(self, index: int, subindex: int = 0) -> str:
        """Read the text of a visible string; '' when the node has none."""
        return (self.read_if_present(index, subindex) or b"").decode("ascii", "replace").strip("\0 ")

    def write_integer(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object in the data sheet's type.

        Raises
        ------
        ConfigurationRefusedError
            The object is not in the data sheet, the value does not fit its type, or the node aborted.
        NodeAbsentError
            It does not answer.
        """
        data = self._to_bytes(index, subindex, value)
        try:
            self._client.download(index, subindex, data)
            self.settings[index, subindex] = value, 0
        except SdoAbortedError as error:
            what = f"writing {_hex(value)} to {self.named(index, subindex)}"
            lacks = "; its data sheet has it: give that of its firmware" if error.code in ABSENT_OBJECT else ""
            raise ConfigurationRefusedError(f"{self.who}: {what} refused: {abort_in_words(error)}{lacks}") from error
        except SdoCommunicationError as error:
            raise NodeAbsentError(f"{self.who}: writing {self.named(index, subindex)}: {error}; is it powered and on this bus?") from error

    def write_checked(self, index: int, subindex: int, value: int, *, ignore_bits: int = 0) -> None:
        """Write an integer object and read it back.

        Raises
        ------
        ConfigurationRefusedError
            As `write_integer`, or the value that comes back differs outside `ignore_bits`.
        """
        self.write_integer(index, subindex, value)
        self.settings[index, subindex] = value, ignore_bits
        back = self.read_integer(index, subindex)
        if (back ^ value) & ~ignore_bits:
            raise ConfigurationRefusedError(
                f"{self.who}: {self.named(index, subindex)} reads back {_hex(back)} after {_hex(value)} was written; "
                "the device does not take this value"
            )

    def write_unheard(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object and do not wait for the answer."""
        self._client.write_unheard(index, subindex, self._to_bytes(index, subindex, value))

    def named(self, index: int, subindex: int) -> str:
        """Return an object in words, with its name where the data sheet has it."""
        variable = self.dictionary.get_variable(index, subindex)
        return f"{index:04X}h:{subindex:02X}{f' ({variable.qualname})' if variable is not None else ''}"

    def to_integer(self, index: int, subindex: int, data: bytes) -> int:
        """Return the value of an integer object, signed where the data sheet says so.

        Some devices answer with four bytes whatever the object's size: those beyond its size do not count.
        """
        variable = self.dictionary.get_variable(index, subindex)
        if variable is None or variable.data_type not in datatypes.INTEGER_TYPES:
            return int.from_bytes(data, "little")
        return int.from_bytes(data[: len(variable) // 8], "little", signed=variable.data_type in datatypes.SIGNED_TYPES)

    def _to_bytes(self, index: int, subindex: int, value: int) -> bytes:
        variable = self.dictionary.get_variable(index, subindex)
        if variable is None:
            raise ConfigurationRefusedError(
                f"{self.who}: object {index:04X}h:{subindex:02X} is not in its EDS file; correct the machine file or the EDS"
            )
        if variable.data_type not in datatypes.INTEGER_TYPES and variable.data_type != datatypes.BOOLEAN:
            raise ConfigurationRefusedError(
                f"{self.who}: {self.named(index, subindex)} is no integer object; only integers can be configured"
            )
        try:
            return value.to_bytes(len(variable) // 8, "little", signed=variable.data_type in datatypes.SIGNED_TYPES)
        except OverflowError as error:
            raise ConfigurationRefusedError(
                f"{self.who}: {value} does not fit {self.named(index, subindex)} of {len(variable)} bits"
            ) from error


def abort_in_words(error: SdoAbortedError) -> str:
    """Return an abort in words, e.g. `object cannot be mapped to the PDO (abort 06040041h)`."""
    words = SdoAbortedError.CODES.get(error.code, "unknown abort code")
    return (
        f"{words[0].lower()}{words[1:]} (abort {error.code:08X}h)" if not words.startswith("SDO") else f"{words} (abort {error.code:08X}h)"
    )


def _hex(value: int) -> str:
    return f"{value} ({value:X}h)" if value >= 0 else str(value)
