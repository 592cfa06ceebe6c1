"""One master on the bus: what only the bench may send, or one device alone, and who else sends it.

A second SYNC moves the machine's time, a second target torque its motors, a second heartbeat keeps drives running whose master is gone. A
bus hands nobody its own frames, so such a frame is somebody else's; where an adapter echoes (`PolledNetwork.echoes`) one copy of each is
the bench's own. Nothing here costs a tick anything unless a frame comes that should not.
"""

from __future__ import annotations

from collections.abc import Sequence

from drivers.canopen.network import HEARTBEAT, PolledNetwork
from drivers.settings import BusSettings

FRAME_BITS = 111  # of 8 bytes without stuffing, with the pause behind it (ISO 11898-1)
FLOOD_SHARE = 0.5
"""Share of what the bus can carry that must remain for the bench and its devices, which take up to half of it at 500 Hz."""
FEWEST_OF_A_FLOOD = 8  # in one period: the heartbeats and emergencies of some nodes may meet
PERSISTENT_TICKS = 4
"""Ticks with a frame too many before a second sender is named: a frame that was held up on its way comes once."""
LATE_TICKS = 256
"""A frame that comes more ticks than this after an answer was missed does not answer it; nor do frames too many so far apart belong
together."""


class OneMaster:
    """Names, through `PolledNetwork.accuse`, whoever sends what is the bench's or one device's alone.

    Parameters
    ----------
    network : PolledNetwork
    settings : BusSettings
    tpdos : sequence of str
        TPDOs that answer every SYNC once, in words; None for others. In the order of their bits.

    Attributes
    ----------
    tick : int
        Number of the bench's tick, kept by the owner.
    flood_frames : int
        Frames of others in one period above which the bus is flooded.
    """

    def __init__(self, network: PolledNetwork, settings: BusSettings, tpdos: Sequence[str | None]) -> None:
        self._network = network
        self._tpdos = tpdos
        self._where = f"on {network.can_bus.channel_info}; switch it off"
        self._heartbeat = HEARTBEAT + settings.master_node_id
        self.tick = 0
        self._own = {
            pdo.cob_id: f"somebody else sends {pdo.cob_id:03X}h, the commands to {node.name},"
            for node in settings.nodes
            for pdo in node.rpdos
        }
        if not settings.sync_producer:
            self._own[settings.sync_cob_id] = f"a second SYNC producer sends {settings.sync_cob_id:03X}h"
        self._own[self._heartbeat] = f"a second master sends the bench's own heartbeat, {self._heartbeat:03X}h,"
        self.flood_frames = max(FEWEST_OF_A_FLOOD, int(FLOOD_SHARE * settings.bitrate_bit_s * settings.sync_period_s / FRAME_BITS))
        self._heard = dict.fromkeys(self._own, 0)
        self._balance = [0] * len(tpdos)  # frames of each TPDO less SYNCs, while answers are missing
        self._missed_at = [-LATE_TICKS] * len(tpdos)  # ticks
        self._extra_at = [-LATE_TICKS] * len(tpdos)
        self._extra_ticks = [0] * len(tpdos)
        self._flooded_at = self._flooded_ticks = 0
        self._early_at, self._early_ticks = -LATE_TICKS, 0
        for identifier in self._own:
            network.subscribe(identifier, self._hear_own)

    def _hear_own(self, identifier: int, data: bytearray, stamp: float) -> None:
        """Take a frame with an identifier that the bench sends."""
        self._heard[identifier] += 1
        sent = self._network.heartbeats_sent if identifier == self._heartbeat else self.tick
        if not self._network.echoes or self._heard[identifier] > sent:
            self._network.accuse(f"{self._own[identifier]} {self._where}")

    def missed(self, bit: int) -> None:
        """Take note that a TPDO has not answered: a frame of it may come later."""
        self._balance[bit] -= 1
        self._missed_at[bit] = self.tick

    def extra(self, bit: int) -> None:
        """Take a frame of a TPDO beyond the one that answers the SYNC."""
        tick = self.tick
        if tick - self._missed_at[bit] > LATE_TICKS:
            self._balance[bit] = 0
        self._balance[bit] += 1
        if self._balance[bit] <= 0:
            return  # it was owed
        self._balance[bit] = 0
        since, self._extra_at[bit] = tick - self._extra_at[bit], tick
        if since:  # several in one tick were held up together
            self._extra_ticks[bit] = self._extra_ticks[bit] + 1 if since <= LATE_TICKS else 1
        if self._extra_ticks[bit] >= PERSISTENT_TICKS and self._tpdos[bit] is not None:
            self._network.accuse(f"{self._tpdos[bit]} comes more than once per SYNC: a second device sends it {self._where}")

    def early_sync(self, producer: str) -> None:
        """Take note of a SYNC that came between two of its producer."""
        since, self._early_at = self.tick - self._early_at, self.tick
        self._early_ticks = self._early_ticks + 1 if since <= LATE_TICKS else 1
        if self._early_ticks >= PERSISTENT_TICKS:
            self._network.accuse(f"SYNC comes between those of {producer}: a second producer sends it {self._where}")

    def flooded(self, frames: int, identifier: int) -> None:
        """Take note of more than `flood_frames` frames of others in one tick, the last with this identifier."""
        self._flooded_ticks = self._flooded_ticks + 1 if self.tick == self._flooded_at + 1 else 1
        self._flooded_at = self.tick
        if self._flooded_ticks >= PERSISTENT_TICKS:
            self._network.accuse(
                f"{frames} frames in one period that nobody here asked for, the last with the identifier {identifier:X}h, "
                f"{self.flood_frames} are bearable: somebody floods the bus {self._where}"
            )
