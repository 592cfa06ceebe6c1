"""What is told of the wire is the present, or is left out."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import can
import pytest
from bench_machines import CARM
from bench_page import until

from drivers.settings import Pdo
from hil.console import wire

CHANNEL = "what-the-wire-tells"
OBJECTS = {0x6041: 0x0637, 0x6064: 4096, 0x6077: 250, 0x6078: 250}
"""Operation enabled, counts, per mille of the rated value."""
WAIT_S = 10.0


def frame(pdo: Pdo) -> can.Message:
    content = shift = 0
    for index, _, bits in pdo.entries:
        content |= OBJECTS.get(index, 0) << shift
        shift += bits
    return can.Message(arbitration_id=pdo.cob_id, data=content.to_bytes(shift // 8, "little"), is_extended_id=False)


def test_a_heartbeat_makes_no_older_value_the_present_one(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now_s=100.0)
    clock.monotonic = lambda: clock.now_s
    monkeypatch.setattr(wire, "time", clock)
    monkeypatch.setattr(wire, "open_bus", lambda url, bitrate: can.Bus(interface="virtual", channel=CHANNEL))
    drive = next(node for node in CARM.bus.nodes if node.role == "drive")
    watch = wire.WireWatch(CARM.bus, "udp:")

    def seen() -> dict[str, Any]:
        return next(each for each in watch.state({})["nodes"] if each["id"] == drive.node_id)

    def heartbeat(state: int) -> can.Message:
        return can.Message(arbitration_id=0x700 + drive.node_id, data=[state], is_extended_id=False)

    with can.Bus(interface="virtual", channel=CHANNEL) as sender:

        def told(*messages: can.Message) -> dict[str, Any]:
            for message in messages:  # again and again: the watch may not have opened the bus yet
                sender.send(message)
            return seen()

        try:
            until(lambda: {"state", "position", "effort"} <= told(*map(frame, drive.tpdos)).keys(), WAIT_S)
            assert "operation enabled" in seen()["state"]
            until(lambda: told(heartbeat(127))["nmt"] == "pre-operational", WAIT_S)  # all PDOs before it have been taken
            clock.now_s += 1.5
            until(lambda: told(heartbeat(5))["nmt"] == "operational", WAIT_S)
            assert seen()["fresh"]
            assert {"state", "position", "effort"}.isdisjoint(seen())
        finally:
            watch.close()
