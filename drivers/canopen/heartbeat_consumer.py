"""Heartbeat consumer of the bench: boot-up with its own time-out, ages of heartbeats, NMT states, and emergencies of all nodes.

CiA 301 monitoring of a heartbeat starts with the first one received: a node that never boots is never missed. So boot-up is awaited first,
and heartbeats are watched afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf

from drivers.canopen.emcy import CODE_BYTES, Emergency, decode_emergency
from drivers.canopen.network import EMERGENCY, HEARTBEAT, NMT_RESET_COMMUNICATION, NMT_STATES, PolledNetwork
from drivers.canopen.sdo import SdoNode
from drivers.errors import BusTimeoutError, DeviceFaultError, DuplicateNodeError, HeartbeatLostError, NodeAbsentError
from drivers.settings import Node

HEARTBEAT_TOLERANCE = 2.5
"""Periods for which a heartbeat may be missing: one lost frame and half a period of jitter."""

LATE_PERIODS = 1.5
"""Periods after which a heartbeat that still comes is told: half of what is borne beyond one period, so that a lost one shows."""

RATE_TOLERANCE = 1.25
"""By how much a heartbeat may be faster than its period: no clock errs by so much, and two devices are twice as fast."""
MOST_AHEAD = 2.5
"""Heartbeats that may have come more than their rate explains: one delayed by a whole period, followed by one in time."""
TOGETHER_SHARE = 0.02
"""Share of a period within which heartbeats were held up by a pause of the bench, and read at once: they count as one."""

AWAY_S, AWAY_PERIODS = 0.05, 4.0
"""Time between two looks at the heartbeats, of a loop that looks every tick, after which the silence is the loop's own."""

STALE_FRAMES = 256  # frames dropped before a reset: a boot-up message from before it is not its answer
BOOT_SETTLE_S = 0.05
"""Time to listen after the last node booted for a second device with one id: equal devices boot in equal time."""

OPERATIONAL = 0x05
BOOT_UP = 0x00
DEVICE_TYPE, SERIAL_NUMBER = 0x1000, (0x1018, 4)


@dataclass
class _Watched:
    """The last messages of one node."""

    name: str
    node_id: int
    period_s: float
    vendor_id: int | None
    state: int = -1  # NMT state of the last heartbeat, -1 before the first message
    heard_s: float = float("nan")
    lost_s: float = 0.0  # of the loop's ticks, by then
    boots: int = 0
    ahead: float = 0.0  # heartbeats that came more than their rate explains
    late: int = 0  # heartbeats that came late, and were borne
    longest_s: float = 0.0  # pause before one of them
    emergency: Emergency | None = None  # newest that is not reset
    timeout_s: float = field(init=False)

    def __post_init__(self) -> None:
        self.timeout_s = HEARTBEAT_TOLERANCE * self.period_s

    @property
    def who(self) -> str:
        return f"{self.name} (node {self.node_id})"


class HeartbeatConsumer:
    """Receives the heartbeats and emergencies of every configured node.

    Parameters
    ----------
    network : PolledNetwork
        Subscribed to.
    nodes : sequence of Node
    period_s : float
        Between the loop's ticks; 0: it does not look every tick.
    """

    def __init__(self, network: PolledNetwork, nodes: Sequence[Node], period_s: float = 0.0) -> None:
        self._network = network
        self._away_s = max(AWAY_S, AWAY_PERIODS * period_s) if period_s > 0.0 else inf
        self._nodes = {node.node_id: _Watched(node.name, node.node_id, node.heartbeat_period_s, node.identity.vendor_id) for node in nodes}
        self._guarded = [watched for watched in self._nodes.values() if watched.timeout_s > 0.0]
        self._turn = 0
        self._lost_s = self._checked_s = 0.0
        self._running = False  # nodes were started, so leaving operational is a fault
        self.boot_remarks: tuple[str, ...] = ()  # what was unusual of the last boot, in words
        self.left_operational = ""  # which started node has left operational, in words; '' while all run
        for node_id in self._nodes:
            network.subscribe(HEARTBEAT + node_id, lambda can_id, data, _: self.heartbeat(can_id - HEARTBEAT, data))
            network.subscribe(EMERGENCY + node_id, lambda can_id, data, _: self.emergency(can_id - EMERGENCY, data))
        self._fresh_fault = ""

    def heartbeat(self, node_id: int, data: bytes | bytearray) -> None:
        """Take a heartbeat or boot-up message (one byte: NMT state)."""
        watched = self._nodes[node_id]
        if len(data) != 1 or data[0] & 0x7F not in NMT_STATES:
            self._network.drop(f"{watched.who}: a heartbeat of the bytes {bytes(data).hex(' ') or 'none'}, which is no NMT state")
            return
        state = data[0] & 0x7F  # bit 7 is reserved
        now_s = self._network.clock.now()
        early = self._running and self._is_early(watched, now_s)
        pause_s = now_s - watched.heard_s - max(0.0, self._lost_s - watched.lost_s)
        if self._running and pause_s > LATE_PERIODS * watched.period_s > 0.0:
            watched.late += 1
            watched.longest_s = max(watched.longest_s, pause_s)
        watched.heard_s, watched.lost_s = now_s, self._lost_s
        if state == BOOT_UP:
            watched.boots += 1
        if self._running and state != OPERATIONAL:
            change = "rebooted" if state == BOOT_UP else f"left operational: {NMT_STATES[state]}"
            if early:
                change += "; it came between two heartbeats, so a second device may have its id"
            self.left_operational = self.left_operational or "; ".join(filter(None, (self.own_silence, f"{watched.who}: {change}")))
        watched.state = state

    def _is_early(self, watched: _Watched, now_s: float) -> bool:
        """Return whether a heartbeat comes before its time; name a second sender if that lasts."""
        since_s, period_s = now_s - watched.heard_s, watched.period_s
        if not since_s > TOGETHER_SHARE * period_s or not period_s:
            return False
        watched.ahead = max(0.0, watched.ahead - RATE_TOLERANCE * since_s / period_s) + 1.0
        if watched.ahead > MOST_AHEAD:
            self._network.accuse(
                f"{watched.who}: its heartbeat comes more often than every {period_s:g} s: a second device has its id; give one of them "
                f"another id, or switch it off"
            )
        return since_s < period_s / RATE_TOLERANCE

    def emergency(self, node_id: int, data: bytes | bytearray) -> None:
        """Take an EMCY message."""
        watched = self._nodes[node_id]
        if len(data) < CODE_BYTES:
            self._network.drop(f"{watched.who}: an EMCY of {len(data)} bytes, which has no error code")
            return
        message = decode_emergency(data)
        watched.emergency = None if message.is_reset else message
        if not message.is_reset:
            self._note(f"{watched.who}: {message.describe(watched.vendor_id)}")

    def _note(self, words: str) -> None:
        self._fresh_fault = self._fresh_fault or words

    def take_fault(self) -> str:
        """Return the first fault noted since the last call, in words; '' when there is none."""
        words, self._fresh_fault = self._fresh_fault, ""
        return words

    @property
    def remarks(self) -> list[str]:
        """Heartbeats that were missing for a while, in words."""
        return [
            f"{watched.who}: late heartbeats: {watched.late}, one after {watched.longest_s:.3f} s; its period is {watched.period_s:g} s"
            for watched in self._nodes.values()
            if watched.late
        ]

    def last_emergency(self, node_id: int) -> str:
        """Return the newest EMCY of a node that was not reset, in words, or ''."""
        watched = self._nodes[node_id]
        return watched.emergency.describe(watched.vendor_id) if watched.emergency else ""

    def nmt_state(self, node_id: int) -> str:
        """Return the last NMT state received, in words."""
        return NMT_STATES.get(self._nodes[node_id].state, "never heard")

    def check_one(self, now_s: float, lost_s: float = 0.0) -> None:
        """Check the next node's heartbeat, one per call: the sample loop calls it every tick and so checks all nodes within a few ticks.

        Parameters
        ----------
        now_s : float
        lost_s : float
            Time of all ticks that the loop has lost. It is no silence: nobody listened, and an emulated machine, whose time SYNC moves,
            stood still.

        Raises
        ------
        HeartbeatLostError
        """
        if not self._guarded:
            return
        since_s = now_s - self._checked_s
        if since_s > self._away_s and (away_s := since_s - max(0.0, lost_s - self._lost_s)) > self._away_s:
            for each in self._guarded:  # nobody listened: this program stood still, or did something else
                each.heard_s = min(now_s, each.heard_s + away_s)
        self._checked_s = now_s
        self._turn = (self._turn + 1) % len(self._guarded)
        watched, self._lost_s = self._guarded[self._turn], lost_s
        age_s = now_s - watched.heard_s
        if age_s > watched.timeout_s and (age_s := age_s - max(0.0, lost_s - watched.lost_s)) > watched.timeout_s:
            state = NMT_STATES.get(watched.state, "unknown")
            raise HeartbeatLostError(
                f"{watched.who}: no heartbeat for {age_s:.3f} s, {watched.timeout_s:.3f} s allowed; its last state was {state}"
            )

    @property
    def own_silence(self) -> str:
        """That this program was silent itself, as long as what nodes made of it may still come, in words; '' where it was not."""
        pause_s = self._network.pause_of_heartbeat(max((watched.timeout_s for watched in self._guarded), default=0.0))
        return f"this program stood still: the nodes heard no master for {pause_s:.2f} s" if pause_s > 0.0 else ""

    def boot(self, nodes: Sequence[Node]) -> None:
        """Reset every node's communication and wait until each has booted.

        Raises
        ------
        NodeAbsentError
            Neither boot-up message nor SDO answer within the node's own time-out.
        DuplicateNodeError
            One reset, two boot-ups from one id.
        """
        for _ in range(STALE_FRAMES):
            if not self._network.pump(0.0):
                break
        for watched in self._nodes.values():
            watched.boots = 0
        for node in nodes:
            if not self.reset(node, node.boot_timeout_s):
                self._ask_directly(node)
        self._network.pump_for(BOOT_SETTLE_S)
        self.boot_remarks = tuple(self._tell_apart(watched) for watched in self._nodes.values() if watched.boots > 1)
        self._fresh_fault = ""

    def _tell_apart(self, watched: _Watched) -> str:
        """Return the note on a device that said its boot-up message twice; its serial number tells it from two devices with one id.

        Answers of two devices that are the same, bit for bit, may come as one frame.
        """
        said = f"{watched.who}: {watched.boots} boot-up messages after one reset"
        sdo = SdoNode(self._network, watched.node_id, watched.name)
        try:
            serial = sdo.read_if_present(*SERIAL_NUMBER) or b""
            sdo.read(DEVICE_TYPE)  # a second answer to the first shows here
        except DuplicateNodeError as error:
            raise DuplicateNodeError(f"{said}: two devices share this id; give one another id") from error
        finally:
            sdo.close()
        if not any(serial):
            raise DuplicateNodeError(
                f"{said}: two devices share this id, or one says it twice; no serial number (1018h:04) tells which; give one another id"
            )
        return f"{said}, but one device answers, with serial number {int.from_bytes(serial, 'little')}: it is taken for one"

    def has_booted(self, node: Node) -> bool:
        """Return whether a node's boot-up message has come since its last reset."""
        return self._nodes[node.node_id].boots > 0

    def reset(self, node: Node, patience_s: float) -> bool:
        """Reset one node's communication and wait for its boot-up message; return whether it came in time.

        Nodes are reset one after the other, so that the order of frames on the bus depends on no race.
        """
        clock, watched = self._network.clock, self._nodes[node.node_id]
        watched.boots = 0
        self._network.command_nmt(NMT_RESET_COMMUNICATION, node.node_id)
        deadline = clock.now() + patience_s
        while not watched.boots and (remaining := deadline - clock.now()) > 0.0:
            if not self._network.pump(remaining):
                break
        return watched.boots > 0

    def _ask_directly(self, node: Node) -> None:
        sdo = SdoNode(self._network, node.node_id, node.name)
        try:
            sdo.read(DEVICE_TYPE)
        except NodeAbsentError as error:
            heard = ", ".join(f"{w.name} ({w.node_id})" for w in self._nodes.values() if w.boots) or "none"
            raise NodeAbsentError(
                f"{node.name} (node {node.node_id}): neither boot-up nor SDO answer within {node.boot_timeout_s:.1f} s of a reset on "
                f"{self._network.can_bus.channel_info}; is it powered, with this id and bit rate? nodes that booted: {heard}"
            ) from error
        finally:
            sdo.close()

    def await_operational(self, nodes: Sequence[Node]) -> None:
        """Wait until every started node's heartbeat says operational; leaving it afterwards is a fault.

        Raises
        ------
        BusTimeoutError
            A node produces no heartbeat, or one with another state.
        DeviceFaultError
            A node fell back while being waited for.
        """
        clock = self._network.clock
        for node in nodes:
            watched = self._nodes[node.node_id]
            deadline = clock.now() + HEARTBEAT_TOLERANCE * node.heartbeat_period_s
            while node.heartbeat_period_s > 0.0 and watched.state != OPERATIONAL:
                remaining = deadline - clock.now()
                if remaining <= 0.0 or not self._network.pump(remaining):
                    if watched.emergency is not None:
                        raise DeviceFaultError(
                            f"{watched.who}: started, but its heartbeat says {self.nmt_state(node.node_id)}, not operational: "
                            f"{self.last_emergency(node.node_id)}; remove the error's cause, and reset it or switch the node off and on"
                        )
                    raise BusTimeoutError(f"{watched.who}: started, but its heartbeat says {self.nmt_state(node.node_id)}, not operational")
        now = clock.now()
        for watched in self._nodes.values():
            watched.heard_s = watched.heard_s if watched.heard_s == watched.heard_s else now
            watched.ahead = watched.longest_s = 0.0
            watched.late = 0
        self._fresh_fault = self.left_operational = ""
        self._running = True

    def stand_down(self) -> None:
        """Allow nodes to leave operational, because they are being stopped on purpose."""
        self._running = False


def refuse_second_bench(network: PolledNetwork, own_node_id: int, heartbeat_period_s: float) -> None:
    """Listen for another master that sends the bench's heartbeat: two masters on one bus would move the same motors.

    Raises
    ------
    DuplicateNodeError
    """
    heard: list[int] = []

    def listen(can_id: int, data: bytearray, stamp: float) -> None:
        heard.append(can_id)

    network.drain()  # frames older than this start
    network.intruder = ""
    network.subscribe(HEARTBEAT + own_node_id, listen)
    network.pump_for(HEARTBEAT_TOLERANCE * heartbeat_period_s)
    network.unsubscribe(HEARTBEAT + own_node_id, listen)
    if heard:
        raise DuplicateNodeError(
            f"node id {own_node_id}, the bench's own, is already on {network.can_bus.channel_info}: "
            "another bench is running there; stop it, or give this one another master_node_id"
        )
