"""The node under test: what its data sheet has, what is read, written and restored, and in which state it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import canopen
from canopen.objectdictionary import ODVariable, datatypes

from drivers.canopen.network import HEARTBEAT, NMT_PRE_OPERATIONAL, NMT_RESET_COMMUNICATION, NMT_START
from hil.conform.check import CheckFailedError, CheckSkippedError
from hil.conform.transfers import MALFORMED, NO_ANSWER, download, head, upload
from hil.conform.wire import Frame, Wire

BOOT_S = 5.0  # longest time from a reset to the boot-up message
BOOT_AGAIN_S = 0.4  # once one has failed to come
STATE_MS = 20  # heartbeat time while states are watched
SHOWN_FRAMES = 6  # of a failed check
INVALID = 1 << 31  # of a COB-ID
STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0x04, 0x05, 0x7F
COMMUNICATION = range(0x1000, 0x2000)
_APPLICATION = range(0x2000, 0x6000)
_CONTROLWORD = 0x6040
_ACTIONS = (0x1003, 0x1010, 0x1011)  # a write does something, and what was there cannot be written back


def within_limits(entry: ODVariable, value: float) -> bool:
    """Return whether the data sheet allows a value; limits that contradict each other allow every one."""
    low, high = entry.min, entry.max
    if low is not None and high is not None and low > high:
        return True
    return (low is None or value >= low) and (high is None or value <= high)


@dataclass(frozen=True)
class Pdo:
    """One PDO by its two objects."""

    communication: int
    mapping: int

    @property
    def receive(self) -> bool:
        """Whether the node receives it."""
        return self.communication < 0x1600

    def __str__(self) -> str:
        """Return its communication object."""
        return f"{self.communication:04X}h"


class Device:
    """One node.

    Parameters
    ----------
    wire : Wire
    dictionary : canopen.ObjectDictionary
        Of its EDS, for its node id.
    writes : bool
        Whether stored and application parameters may be altered.
    others : bool
        Whether other nodes are on the bus, which broadcasts would reach.
    """

    def __init__(self, wire: Wire, dictionary: canopen.ObjectDictionary, *, writes: bool, others: bool) -> None:
        self.wire, self.node_id, self.dictionary = wire, wire.node_id, dictionary
        self.writes, self.others = writes, others
        self.entries: list[ODVariable] = []
        for index, item in dictionary.items():
            if index >= COMMUNICATION.start:
                self.entries += [item] if isinstance(item, ODVariable) else list(item.values())
        self._by_address = {(entry.index, entry.subindex): entry for entry in self.entries}
        self.begun = 0  # place in the log where the present check began
        self._before: dict[tuple[int, int], bytes] = {}  # what was written over by the present check
        self._needs_reset = False
        self.not_restored: list[str] = []
        self._boot_s = BOOT_S

    # ---- what the data sheet has ----------------------------------------------------------------------
    def entry(self, index: int, subindex: int = 0) -> ODVariable | None:
        """Return an entry of the data sheet, None where it has none."""
        return self._by_address.get((index, subindex))

    def has_object(self, index: int) -> bool:
        """Return whether the data sheet has an object of this index."""
        return index in self.dictionary

    def need(self, index: int, subindex: int = 0, *, writable: bool = True) -> ODVariable:
        """Return an entry that a check stands on; skip the check where there is none."""
        entry = self.entry(index, subindex)
        if entry is None:
            raise CheckSkippedError(f"the data sheet has no {index:04X}h:{subindex:02X}")
        if writable and not entry.writable:
            raise CheckSkippedError(f"{index:04X}h:{subindex:02X} cannot be written")
        return entry

    def pdos(self, *, receive: bool) -> list[Pdo]:
        """Return the PDOs of one direction whose objects the data sheet has."""
        first, first_mapping = (0x1400, 0x1600) if receive else (0x1800, 0x1A00)
        pairs = [Pdo(first + i, first_mapping + i) for i in range(512)]
        return [pdo for pdo in pairs if self.entry(pdo.communication, 1) is not None and self.entry(pdo.mapping) is not None]

    def is_command(self, entry: ODVariable) -> bool:
        """Return whether an object may set something in motion: it is never written.

        These are what a profile lets an RPDO carry, what can only be written, and the controlword.
        """
        if entry.index == _CONTROLWORD or entry.access_type == "wo":
            return True
        return entry.index not in COMMUNICATION and entry.index not in _APPLICATION and bool(entry.pdo_mappable)

    def parameters(self) -> list[ODVariable]:
        """Return the entries that are read and written and command nothing."""
        return [entry for entry in self.entries if entry.writable and entry.readable and not self.is_command(entry)]

    def spare_object(self) -> ODVariable:
        """Return a manufacturer's object that both directions may map, for values to be seen; skip the check where there is none."""
        if not self.writes:
            raise CheckSkippedError("writes an application object: give --writes")
        for entry in self.entries:
            fits = entry.data_type in (datatypes.UNSIGNED16, datatypes.UNSIGNED32, datatypes.INTEGER16, datatypes.INTEGER32)
            if entry.index in _APPLICATION and entry.pdo_mappable and entry.access_type == "rw" and fits:
                return entry
        raise CheckSkippedError("no manufacturer's object of two or four bytes can be mapped in both directions")

    # ---- judging --------------------------------------------------------------------------------------
    def expect(self, right: bool, expected: str, frames: Sequence[Frame] | None = None) -> None:
        """Fail the check unless it is `right`, with the frames that were wrong: the last exchange unless given."""
        if not right:
            raise CheckFailedError(expected, self.last_exchange() if frames is None else frames)

    def last_exchange(self) -> list[Frame]:
        """Return the last frame that was sent in this check and what came after it."""
        frames = self.wire.log[self.begun :]
        sent = [place for place, frame in enumerate(frames) if frame.sent]
        return frames[sent[-1] if sent else 0 :][:SHOWN_FRAMES]

    def expect_code(self, code: int, allowed: Sequence[int], what: str) -> None:
        """Fail the check unless a transfer ended with one of these abort codes; 0 is success."""
        codes = [f"{wanted >> 16:04X} {wanted & 0xFFFF:04X}h" for wanted in dict.fromkeys(allowed) if wanted]
        words = "" if not codes else f": abort {codes[0]}" if len(codes) == 1 else f": abort {', '.join(codes[:-1])} or {codes[-1]}"
        self.expect(code in allowed, what + words)

    # ---- objects --------------------------------------------------------------------------------------
    def try_read(self, index: int, subindex: int = 0) -> bytes | int:
        """Return an object's bytes, or the abort code."""
        return upload(self.wire, index, subindex)

    def read(self, index: int, subindex: int = 0) -> bytes:
        """Return an object's bytes; an abort fails the check."""
        value = self.try_read(index, subindex)
        self.expect(isinstance(value, bytes), f"{index:04X}h:{subindex:02X} is read")
        assert isinstance(value, bytes)
        return value

    def number(self, index: int, subindex: int = 0) -> int:
        """Return an unsigned value."""
        return int.from_bytes(self.read(index, subindex), "little")

    def size_of(self, index: int, subindex: int) -> int:
        """Return the bytes of an object by its data sheet."""
        entry = self.entry(index, subindex)
        return (len(entry) + 7) // 8 if entry is not None else 4

    def try_write(self, index: int, subindex: int, data: bytes) -> int:
        """Write bytes; return 0 or the abort code. What was there is put back when the check is over."""
        key = (index, subindex)
        if key not in self._before and index not in _ACTIONS:
            before = self.try_read(index, subindex)
            self._before[key] = before if isinstance(before, bytes) else b""
        code = download(self.wire, index, subindex, data)
        if code in (NO_ANSWER, MALFORMED):
            self._needs_reset = True
        return code

    def write(self, index: int, subindex: int, value: int) -> None:
        """Write a number; an abort fails the check, and a value that the data sheet does not allow skips it."""
        entry = self.entry(index, subindex)
        if entry is not None and not within_limits(entry, value):
            raise CheckSkippedError(f"the data sheet gives {index:04X}h:{subindex:02X} limits that {value:X}h is beyond")
        code = self.try_write(index, subindex, value.to_bytes(self.size_of(index, subindex), "little"))
        self.expect(code == 0, f"{index:04X}h:{subindex:02X} takes {value:X}h")

    def try_number(self, index: int, subindex: int, value: int) -> int:
        """Write a number; return 0 or the abort code."""
        return self.try_write(index, subindex, value.to_bytes(self.size_of(index, subindex), "little"))

    # ---- states ---------------------------------------------------------------------------------------
    def nmt(self, command: int, node_id: int | None = None) -> None:
        """Send an NMT command to the node, or to another address."""
        self.wire.send(0x000, bytes((command, self.node_id if node_id is None else node_id)))

    def reset(self, command: int = NMT_RESET_COMMUNICATION) -> Frame | None:
        """Reset the node and return its boot-up message, None when none comes in time."""
        since = self.wire.mark()
        self.nmt(command)
        deadline = self.wire.now() + self._boot_s
        while (left_s := deadline - self.wire.now()) > 0.0:
            for frame in self.wire.heard(HEARTBEAT + self.node_id, since):
                if frame.data == b"\0":
                    return frame
            if self.wire.wait(HEARTBEAT + self.node_id, left_s) is None:
                break
        self._boot_s = BOOT_AGAIN_S
        return None

    def watch_state(self) -> None:
        """Let the node tell its state: by heartbeat, else by guarding; skip the check where it has neither."""
        entry = self.entry(0x1017)
        if entry is not None and entry.writable:
            self.write(0x1017, 0, STATE_MS)
        elif not self.has_object(0x100C):
            raise CheckSkippedError("the data sheet has neither a heartbeat time (1017h) to set nor guarding (100Ch)")

    def state(self) -> int:
        """Return the state that the node tells, after what was sent before; -1 when it tells none."""
        if (entry := self.entry(0x1017)) is None or not entry.writable:
            self.wire.send(HEARTBEAT + self.node_id, remote=True)
        else:
            self.wire.listen(0.5e-3 * STATE_MS)
        frame = self.wire.wait(HEARTBEAT + self.node_id, 20e-3 * STATE_MS)
        return -1 if frame is None or len(frame.data) != 1 else frame.data[0] & 0x7F

    def go_operational(self) -> int:
        """Start the node; return the log's place from which on it is operational."""
        self.nmt(NMT_START)
        self._needs_reset = True
        self.wire.listen(0.03)
        return self.wire.mark()

    def go_pre_operational(self) -> None:
        """Take the node out of operational."""
        self.nmt(NMT_PRE_OPERATIONAL)

    def is_there(self) -> bool:
        """Return whether anything answers, rightly or wrongly."""
        return self.wire.sdo(head(0x40, 0x1000, 0)) is not None

    def is_alive(self) -> bool:
        """Return whether the SDO server answers."""
        return isinstance(self.try_read(0x1000), bytes)

    # ---- after a check --------------------------------------------------------------------------------
    def must_reset(self) -> None:
        """Have the communication reset when the check is over."""
        self._needs_reset = True

    def begin(self) -> None:
        """Begin a check."""
        self.begun = self.wire.mark()

    def restore(self) -> None:
        """Put back what the check has written, and leave the node in pre-operational."""
        before, self._before = self._before, {}
        if any(0x1400 <= index < 0x1C00 for index, _ in before) or self._needs_reset:
            self._needs_reset = False
            self.reset()
        for (index, subindex), data in reversed(before.items()):
            if not data or self.try_read(index, subindex) == data:
                continue
            code = download(self.wire, index, subindex, data)
            if code and index in COMMUNICATION:
                self.reset()
                code = 0 if self.try_read(index, subindex) == data else code
            if code:
                self.not_restored.append(f"{index:04X}h:{subindex:02X} was {data.hex(' ').upper()}")
