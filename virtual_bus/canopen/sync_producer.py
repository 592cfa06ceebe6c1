"""A device that generates the SYNC itself (1005h bit 30, 1006h)."""

from __future__ import annotations

import math

from virtual_bus.canopen.cob_id import CAN_ID
from virtual_bus.canopen.communication import GENERATES_SYNC
from virtual_bus.canopen.objects import key_of
from virtual_bus.canopen.port import Port


class SyncProducer:
    """Sends SYNC every 1006h microseconds and answers it itself.

    Where 1019h is set, each SYNC carries a counter from 1 to that value.
    """

    def __init__(self, node: Port) -> None:
        self._node = node
        self._counter = 0
        self.deadline_s = math.inf
        node.objects.effects[key_of(0x1006)] = lambda value: self.start()

    def start(self) -> None:
        """Begin with the dictionary's present settings."""
        self._counter = 0
        period_s = self._period_s()
        self.deadline_s = self._node.after(period_s) if period_s else math.inf
        self._node.schedule(self.deadline_s)

    def _period_s(self) -> float:
        objects = self._node.objects
        return objects.number(0x1006) * 1e-6 if objects.number(0x1005) & GENERATES_SYNC and self._node.may_tell else 0.0

    def expire(self, now_s: float) -> None:
        """Send the SYNC that is due; after a long pause one, not a burst."""
        if now_s < self.deadline_s:
            return
        period_s = self._period_s()
        if not period_s:
            self.deadline_s = math.inf
            return
        self.deadline_s += period_s
        if self.deadline_s <= now_s:
            self.deadline_s = self._node.after(period_s)
        overflow = self._node.objects.number(0x1019)
        data = b""
        if overflow:
            self._counter = self._counter % overflow + 1
            data = bytes((self._counter,))
        self._node.emit(self._node.objects.number(0x1005) & CAN_ID, data)
        self._node.sync(data)
