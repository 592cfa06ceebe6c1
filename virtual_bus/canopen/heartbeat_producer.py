"""Heartbeat producer (CiA 301, 7.2.8.2.2)."""

from __future__ import annotations

import math

from virtual_bus.canopen.objects import key_of
from virtual_bus.canopen.port import Port


class HeartbeatProducer:
    """Sends the NMT state every 1017h milliseconds.

    It begins at once when the time is written, and one period after a boot-up.
    """

    def __init__(self, node: Port) -> None:
        self._node = node
        self.deadline_s = math.inf
        node.objects.effects[key_of(0x1017)] = lambda value: self.start(at_once=True)

    @property
    def _period_s(self) -> float:
        return self._node.objects.number(0x1017) * 1e-3

    def start(self, *, at_once: bool) -> None:
        """Begin with the period in the dictionary; 0 stops."""
        first_s = 0.0 if at_once else self._period_s
        self.deadline_s = self._node.after(first_s) if self._period_s else math.inf
        self._node.schedule(self.deadline_s)

    def expire(self, now_s: float) -> None:
        """Send what is due; after a long pause one heartbeat, not a burst."""
        if now_s >= self.deadline_s:
            self._node.send_heartbeat()
            self.deadline_s += self._period_s
            if self.deadline_s <= now_s:
                self.deadline_s = self._node.after(self._period_s)
