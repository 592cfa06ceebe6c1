"""What the wire tells: the state of each drive, heartbeats, emergencies, SYNC, and how full the bus is. Nothing is sent.

Only a bus that several processes can open is listened to; of any other the rows of the run tell what there is.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import can

from drivers.bus_url import open_bus, parse_bus_url
from drivers.canopen.cia402 import describe_statusword
from drivers.canopen.emcy import decode_emergency
from drivers.errors import DriverError
from drivers.settings import BusSettings, Node, Pdo
from drivers.supervisor_link.process import SHARED_BY_PROCESSES
from hil.machine.bus_load import frame_bits

LISTEN_S = 0.2
WINDOW_S = 1.0
SILENT_S = 1.0
"""Age at which a value is no longer the present one."""
_STATUSWORD, _POSITION, _LINK, _TORQUE, _CURRENT = 0x6041, 0x6064, 0x6004, 0x6077, 0x6078
_SIGNED = (_POSITION, _TORQUE, _CURRENT)
_EMERGENCY, _HEARTBEAT = 0x080, 0x700
_NMT_STATES = {0: "boot-up", 4: "stopped", 5: "operational", 127: "pre-operational"}


@dataclass
class _NodeSeen:
    """The newest of one node."""

    node: Node
    values: dict[int, tuple[float, int]] = field(default_factory=dict)  # by index of the object: when it was heard [s], and its value
    heard_s: float = float("-inf")
    nmt: str = ""
    emergency: str = ""


class WireWatch:
    """Listens to a bus in a thread of the server's process.

    Parameters
    ----------
    settings : BusSettings
    url : str
    """

    def __init__(self, settings: BusSettings, url: str) -> None:
        self._settings, self._url = settings, url
        self._nodes = {node.node_id: _NodeSeen(node) for node in settings.nodes}
        self._pdos: dict[int, tuple[_NodeSeen, Pdo]] = {
            pdo.cob_id: (self._nodes[node.node_id], pdo) for node in settings.nodes for pdo in node.tpdos
        }
        self._frames = self._bits = self._syncs = 0
        self._rates = {"load": 0.0, "frames_Hz": 0.0, "sync_Hz": 0.0}
        self._ends = threading.Event()
        self.trouble = ""
        self._thread = threading.Thread(target=self._listen, name="isocenter-wire", daemon=True)
        if parse_bus_url(url).interface not in SHARED_BY_PROCESSES:
            self.trouble = f"{url} has one owner, so nothing can listen beside the run"
        else:
            self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ends.set()
        if self._thread.ident is not None:
            self._thread.join(5.0)

    def state(self, newest: Mapping[str, float | None]) -> dict[str, Any]:
        """Return what was heard, as plain values.

        Parameters
        ----------
        newest : mapping
            The newest row of a run, for a bus that cannot be listened to; empty where nothing runs.
        """
        now_s = time.monotonic()
        return {
            "trouble": self.trouble,
            **self._rates,
            "nodes": [self._from_row(newest, self._node(seen, now_s)) for seen in list(self._nodes.values())],
        }

    def _node(self, seen: _NodeSeen, now_s: float) -> dict[str, Any]:
        node = seen.node
        values = {index: value for index, (heard_s, value) in list(seen.values.items()) if now_s - heard_s < SILENT_S}
        fresh = now_s - seen.heard_s < SILENT_S
        found: dict[str, Any] = {
            "name": node.name,
            "id": node.node_id,
            "role": node.role,
            "axis": node.axis,
            "nmt": seen.nmt if fresh else "not heard" if self.trouble else "silent",
            "emergency": seen.emergency,
            "fresh": fresh,
        }
        scaling = next((each for each in self._settings.scalings if each.axis == node.axis), None)
        if scaling is None:
            return found
        if _STATUSWORD in values and node.role == "drive":
            found["state"] = describe_statusword(values[_STATUSWORD])
        if _POSITION in values and node.role == "drive":
            found["position"] = scaling.sign * values[_POSITION] * scaling.position_resolution
        if _LINK in values and scaling.link_resolution:
            half = 1 << _bits_of(node, _LINK) - 1  # its counter goes round
            counts = (values[_LINK] - scaling.link_zero_counts + half) % (2 * half) - half
            found["position"] = counts * scaling.link_resolution
        for index in (_TORQUE, _CURRENT):
            if index in values:  # per mille of the rated value
                found["effort"] = scaling.sign * values[index] / 1000.0 * scaling.rated
        return found

    def _from_row(self, newest: Mapping[str, float | None], found: dict[str, Any]) -> dict[str, Any]:
        """Complete what was not heard by what the newest row has."""
        axis, is_drive = found["axis"], found["role"] == "drive"
        statusword = newest.get(f"statusword_{axis}")
        if not self.trouble or statusword is None:
            return found
        values = {"position": newest.get(f"{'' if is_drive else 'link_'}position_{axis}")}
        if is_drive:
            values["effort"] = newest.get(f"current_{axis}", newest.get(f"effort_{axis}"))
            found["state"] = describe_statusword(int(statusword))
        return found | {key: value for key, value in values.items() if value is not None} | {"nmt": "told by its rows"}

    def _listen(self) -> None:
        while not self._ends.is_set():
            try:
                with open_bus(self._url, self._settings.bitrate_bit_s) as bus:
                    self.trouble = ""
                    self._hear(bus)
            except (DriverError, can.CanError, OSError) as error:
                self.trouble = str(error)
                self._ends.wait(WINDOW_S)

    def _hear(self, bus: can.BusABC) -> None:
        began_s = time.monotonic()
        while not self._ends.is_set():
            message = bus.recv(LISTEN_S)
            if message is not None and not (message.is_extended_id or message.is_error_frame or message.is_remote_frame):
                self._take(message.arbitration_id, bytes(message.data))
            now_s = time.monotonic()
            if (took_s := now_s - began_s) >= WINDOW_S:
                self._rates = {
                    "load": self._bits / took_s / self._settings.bitrate_bit_s,
                    "frames_Hz": self._frames / took_s,
                    "sync_Hz": self._syncs / took_s,
                }
                self._frames = self._bits = self._syncs = 0
                began_s = now_s

    def _take(self, can_id: int, data: bytes) -> None:
        self._frames += 1
        self._bits += frame_bits(len(data))
        if can_id == self._settings.sync_cob_id:
            self._syncs += 1
        elif can_id in self._pdos:
            seen, pdo = self._pdos[can_id]
            seen.heard_s = time.monotonic()
            seen.values |= {index: (seen.heard_s, value) for index, value in _entries(pdo, data).items()}
        elif can_id & 0x780 == _EMERGENCY and (node := self._nodes.get(can_id & 0x7F)) is not None:
            emergency = decode_emergency(data)
            node.emergency = "" if emergency.is_reset else emergency.describe(node.node.identity.vendor_id)
        elif can_id & 0x780 == _HEARTBEAT and data and (node := self._nodes.get(can_id & 0x7F)) is not None:
            node.heard_s = time.monotonic()
            node.nmt = _NMT_STATES.get(data[0] & 0x7F, f"state {data[0]}")


def _bits_of(node: Node, wanted: int) -> int:
    return next(bits for pdo in node.tpdos for index, _, bits in pdo.entries if index == wanted)


def _entries(pdo: Pdo, data: bytes) -> dict[int, int]:
    """Return the mapped objects of a frame by their index; what a short frame has not is left out."""
    values: dict[int, int] = {}
    content = int.from_bytes(data, "little")
    shift = 0
    for index, _, bits in pdo.entries:
        if shift + bits > 8 * len(data):
            break
        value = content >> shift & (1 << bits) - 1
        values[index] = value - (1 << bits) if index in _SIGNED and value >> bits - 1 else value
        shift += bits
    return values
