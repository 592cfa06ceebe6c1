"""Settings of the nodes while the machine runs: who else writes them is seen on the wire, what they hold is read back in turn.

A drive whose heartbeat consumer, option codes or ramps were changed moves as before, and fails when it should stop. So a foreign SDO
request to one of the machine's nodes ends the run, unless the machine file allows it by name, and what was changed is written again at
once: the stop that follows needs it. A bus hands nobody its own frames, so such a frame is somebody else's; where an adapter echoes, as
many are the bench's own as it has sent. What nobody has seen being written is read back: one object after the other, those first that
decide how a drive stops.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from drivers.canopen.cia402 import MODES_DISPLAY, MODES_OF_OPERATION
from drivers.canopen.network import SDO_REQUEST, PolledNetwork
from drivers.canopen.sdo import RESPONSE_TIMEOUT_S, Address, SdoNode
from drivers.errors import BusError
from drivers.settings import BusSettings, Node

READS_PER_S = 16.0
"""Of all nodes together: 32 frames in a second, 0.4 % of a bus at 1 Mbit/s; what decides a stop comes round in some seconds."""
DECISIVE = (0x1016, 0x6007, 0x605A, 0x605B, 0x605C, 0x605E, MODES_OF_OPERATION, MODES_DISPLAY, 0x6072, 0x6073, 0x6084, 0x6085)
"""Objects that decide how a drive stops, and RPDOs (14xxh), whose deadline does: every second reading is of one of them."""
RPDOS = range(0x1400, 0x1600)
EXPEDITED_UPLOAD, EXPEDITED, ABORT = 0x42, 0xE2, 0x80  # of an answer's first byte: value, its mask; abort
_DOWNLOADS, _UPLOADS = (0x20, 0xC0), (0x40, 0xA0)  # command specifiers of requests that begin a transfer, segmented and in blocks


class SettingsWatch:
    """Names, through `PolledNetwork.accuse`, whoever asks or writes over SDO, and settings that are not what was written.

    Parameters
    ----------
    network : PolledNetwork
    settings : BusSettings
    """

    def __init__(self, network: PolledNetwork, settings: BusSettings) -> None:
        self._network = network
        self._nodes: dict[int, Node] = {SDO_REQUEST + node.node_id: node for node in settings.nodes}
        self._heard = dict.fromkeys(self._nodes, 0)
        self._allowed = dict.fromkeys(self._nodes, 0)  # foreign requests to nodes whose entry in the machine file names who may
        self._sdos: dict[int, SdoNode] = {}
        self._every = max(1, round(1.0 / (READS_PER_S * settings.sync_period_s)))  # ticks
        self._ticks = 0
        self._in_turn: Iterator[tuple[SdoNode, Address]] = iter(())
        self._asked: tuple[SdoNode, Address] | None = None
        self.read = 0  # objects that were read back, and held what they should
        self._found = ""  # what a stop has read back that was not what was written
        for identifier in self._nodes:
            network.subscribe(identifier, self._hear)

    def begin(self, sdos: Iterable[SdoNode]) -> None:
        """Watch what was written to these nodes."""
        self._sdos = {SDO_REQUEST + sdo.node_id: sdo for sdo in sdos}
        self._asked, self._found = None, ""
        self._in_turn = self._turns()

    def tick(self) -> None:
        """Take an answer that has come, and ask for the next object when it is due. Never waits."""
        if self._asked is not None:
            sdo, address = self._asked
            answer = sdo.answer()
            if answer is None:
                return
            self._asked = None
            self._judge(sdo, address, answer)
        self._ticks += 1
        if self._ticks % self._every == 0 and (following := next(self._in_turn, None)) is not None:
            self._asked = following
            following[0].ask(*following[1])

    def verify(self) -> None:
        """Read what decides a stop back from every drive at once, as far as it answers.

        Raises
        ------
        BusError
            Something else is there than was written; it was written again.
        """
        drives = [sdo for identifier, sdo in self._sdos.items() if self._nodes[identifier].role == "drive"]
        self._found = "; ".join(filter(None, [words for sdo in drives for words in self._wrong(sdo)]))
        if self._found:
            raise BusError(self._found)

    def _wrong(self, sdo: SdoNode) -> Iterator[str]:
        """Read what decides a stop, until the node does not answer; return what is wrong with each object in words, '' where nothing is."""
        for address in _addresses(sdo, decisive=True):
            sdo.ask(*address)
            until_s = self._network.clock.now() + RESPONSE_TIMEOUT_S
            while (answer := sdo.answer()) is None and (left_s := until_s - self._network.clock.now()) > 0.0 and self._network.pump(left_s):
                pass
            if not answer:
                return
            yield self._compare(sdo, address, answer)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What an operator should know: requests of others that the machine file allows, and what the last stop has read back."""
        return tuple(
            f"{self._nodes[identifier].name}: {count} SDO requests of somebody else; the machine file allows them: "
            f"{self._nodes[identifier].foreign_sdo}"
            for identifier, count in self._allowed.items()
            if count
        ) + ((self._found,) if self._found else ())

    def _turns(self) -> Iterator[tuple[SdoNode, Address]]:
        """Return the objects in turn, without end: one that decides a stop, one of all."""
        decisive, every = self._rounds(decisive=True), self._rounds(decisive=False)
        while (of_all := next(every, None)) is not None:
            yield next(decisive, of_all)
            yield of_all

    def _rounds(self, *, decisive: bool) -> Iterator[tuple[SdoNode, Address]]:
        while written := [(sdo, address) for sdo in self._sdos.values() for address in _addresses(sdo, decisive=decisive)]:
            yield from written

    def _judge(self, sdo: SdoNode, address: Address, answer: bytes) -> None:
        if words := self._compare(sdo, address, answer):
            self._network.accuse(words)

    def _compare(self, sdo: SdoNode, address: Address, answer: bytes) -> str:
        """Return what is wrong with an answer, in words, and write again what should be there; '' where nothing is."""
        if not answer or answer[0] & EXPEDITED != EXPEDITED_UPLOAD or address not in sdo.settings:
            return ""
        value = sdo.to_integer(*address, answer[4 : 8 - (answer[0] >> 2 & 3)])
        wanted, ignored = sdo.settings[address]
        if not (value ^ wanted) & ~ignored:
            self.read += 1
            return ""
        self._write_again(sdo, address)
        return f"{sdo.who}: {sdo.named(*address)} is {value}, {wanted} was written: somebody, or the device itself, has changed it"

    def _write_again(self, sdo: SdoNode, address: Address) -> None:
        if address == (MODES_DISPLAY, 0):
            sdo.write_unheard(MODES_OF_OPERATION, 0, sdo.settings[address][0])
        else:
            sdo.write_unheard(*address, sdo.settings[address][0])

    def _hear(self, identifier: int, data: bytearray, stamp: float) -> None:
        """Take an SDO request to one of the machine's nodes."""
        self._heard[identifier] += 1
        if self._network.echoes and self._heard[identifier] <= self._network.sent.get(identifier, 0):
            return
        node, sdo = self._nodes[identifier], self._sdos.get(identifier)
        if sdo is not None:
            sdo.owe_another()
        if node.foreign_sdo:
            self._allowed[identifier] += 1
            return
        verb, address = _request(bytes(data))
        if sdo is not None and verb == "writes" and address in sdo.settings:
            self._write_again(sdo, address)
        what = f" and {verb} {sdo.named(*address) if sdo is not None else f'{address[0]:04X}h:{address[1]:02X}'}" if verb else ""
        where = self._network.can_bus.channel_info
        self._network.accuse(
            f"somebody else sends {identifier:03X}h, SDO requests to {node.name},{what} on {where}; switch it off, or name it as "
            f"bus.nodes.{node.name}.foreign_sdo"
        )


def _request(data: bytes) -> tuple[str, Address]:
    """Return what a request begins to do, "reads" or "writes", "" for any other, and to which object."""
    if len(data) < 4:
        return "", (0, 0)
    specifier = data[0] & 0xE0
    verb = "writes" if specifier in _DOWNLOADS else "reads" if specifier in _UPLOADS else ""
    return verb, (int.from_bytes(data[1:3], "little"), data[3])


def _addresses(sdo: SdoNode, *, decisive: bool) -> list[Address]:
    """Return the objects of a node that were written, all or those that decide a stop."""
    return [address for address in sdo.settings if not decisive or address[0] in DECISIVE or address[0] in RPDOS]
