"""Heartbeat consumer (CiA 301, 7.2.8.2.2)."""

from __future__ import annotations

import math
from functools import partial

from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.objects import Value
from virtual_bus.canopen.port import Port


class _Watch:
    """One supervised node."""

    __slots__ = ("deadline_s", "lost", "timeout_s")

    def __init__(self, timeout_s: float) -> None:
        self.timeout_s = timeout_s
        self.deadline_s = math.inf  # supervision starts with the first heartbeat
        self.lost = False


class HeartbeatConsumer:
    """Supervises the nodes in 1016h.

    A node that falls silent raises EMCY 8130h and the device's reaction to a lost connection.
    """

    def __init__(self, node: Port) -> None:
        self._node = node
        self._watches: dict[int, _Watch] = {}
        self.deadline_s = math.inf
        self._entries = [entry for entry in node.objects if entry.index == 0x1016 and entry.subindex]
        for entry in self._entries:
            node.objects.checks[entry.key] = partial(self._check, entry.key)
            node.objects.effects[entry.key] = lambda value: self.configure()

    def _check(self, key: int, value: Value) -> None:
        node_id, time_ms = int(value) >> 16 & 0x7F, int(value) & 0xFFFF
        if int(value) >> 24 or not (node_id and time_ms):
            return  # such an entry is unused
        if any(entry.key != key and int(entry.value) & 0xFFFF and int(entry.value) >> 16 == node_id for entry in self._entries):
            raise SdoAbortError(abort.INCOMPATIBLE)

    def configure(self) -> None:
        """Take over 1016h; supervision of an unchanged entry goes on."""
        watches = {}
        for entry in self._entries:
            value = int(entry.value)
            node_id, timeout_s = value >> 16 & 0xFF, (value & 0xFFFF) * 1e-3
            if not (1 <= node_id <= 127 and timeout_s):
                continue
            old = self._watches.get(node_id)
            watches[node_id] = old if old is not None and old.timeout_s == timeout_s else _Watch(timeout_s)
        self._watches = watches
        self._set_deadline()
        self._node.routes_changed()

    def reset(self) -> None:
        """Forget all heartbeats heard, and supervise anew."""
        self._watches = {}
        self.configure()

    @property
    def supervised(self) -> tuple[int, ...]:
        """Node ids that are supervised."""
        return tuple(self._watches)

    @property
    def lost(self) -> bool:
        """Whether one of them is silent."""
        return any(watch.lost for watch in self._watches.values())

    def heard(self, node_id: int) -> None:
        """Take a heartbeat or boot-up of a node."""
        watch = self._watches[node_id]
        watch.deadline_s = self._node.after(watch.timeout_s)
        if watch.lost:
            watch.lost = False
            self._node.heartbeat_found()
        if watch.deadline_s < self.deadline_s or self.deadline_s == math.inf:
            self.deadline_s = watch.deadline_s
            self._node.schedule(self.deadline_s)

    def expire(self, now_s: float) -> None:
        """Report the nodes that are overdue as lost."""
        lost = []
        for node_id, watch in self._watches.items():
            if now_s >= watch.deadline_s:
                watch.deadline_s, watch.lost = math.inf, True
                lost.append(node_id)
        self._set_deadline()
        for node_id in lost:
            self._node.heartbeat_lost(node_id)

    def _set_deadline(self) -> None:
        self.deadline_s = min([watch.deadline_s for watch in self._watches.values()], default=math.inf)
        self._node.schedule(self.deadline_s)
