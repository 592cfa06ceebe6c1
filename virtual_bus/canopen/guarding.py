"""Node guarding and life guarding (CiA 301, 7.2.8.2.2.2 and 7.2.8.3.2.1), of a device that has 100Ch and 100Dh."""

from __future__ import annotations

import math

from virtual_bus.canopen.objects import key_of
from virtual_bus.canopen.port import Port

TOGGLE = 0x80


class Guarding:
    """Answers the master's remote frames with the NMT state and a bit that toggles, and misses them when they stay away.

    A heartbeat (1017h) takes its place. Life guarding begins with the first remote frame; a master that is silent for guard time times
    life time factor is reported like a heartbeat that is lost.
    """

    def __init__(self, node: Port) -> None:
        self._node = node
        self._toggle = 0
        self.lost = False
        self.deadline_s = math.inf
        for index in (0x100C, 0x100D):
            node.objects.effects[key_of(index)] = lambda value: self._stop_watching()

    def reset(self) -> None:
        """Begin anew: the first answer has its toggle bit clear."""
        self._toggle, self.lost = 0, False
        self._stop_watching()

    def _stop_watching(self) -> None:
        self.deadline_s = math.inf

    @property
    def _used(self) -> bool:
        objects = self._node.objects
        return 0x100C in objects and not objects.number(0x1017)

    def asked(self) -> None:
        """Answer a remote frame of the master."""
        if not self._used:
            return
        self._node.send_heartbeat(self._toggle)
        self._toggle ^= TOGGLE
        if self.lost:
            self.lost = False
            self._node.heartbeat_found()
        objects = self._node.objects
        life_s = objects.number(0x100C) * objects.number(0x100D) * 1e-3
        self.deadline_s = self._node.after(life_s) if life_s else math.inf
        self._node.schedule(self.deadline_s)

    def expire(self, now_s: float) -> None:
        """Report a master that has not asked within the life time."""
        if now_s >= self.deadline_s:
            self.deadline_s = math.inf
            if self._used:
                self.lost = True
                self._node.heartbeat_lost(0)
