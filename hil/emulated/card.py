"""Files in which emulators on this host announce the ports of IMU, I/O and panel beside their CAN bus, for `run --bus URL`.

A real machine needs none of this: its serial device and I/O address are in the machine file or on the command line.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

MAX_PID = 2**31 - 1


@dataclass(frozen=True)
class EmulatorCard:
    """The ports that an emulator announces."""

    bus: str
    pid: int
    imu_device: str  # tcp:HOST:PORT; "" when the machine has no IMU
    io_url: str  # "" when it has no I/O
    panel_url: str = ""  # "" when it has no panel
    panel_scene: str = ""  # the objects in that panel's beam


def _folder() -> Path:
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(base) / f"isocenter-{os.getuid() if hasattr(os, 'getuid') else 'user'}"


def _card_path(bus_url: str) -> Path:
    return _folder() / f"{hashlib.sha256(bus_url.encode()).hexdigest()[:16]}.json"


@contextlib.contextmanager
def published(card: EmulatorCard) -> Iterator[None]:
    """Publish a card for the length of the block."""
    path = _card_path(card.bus)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    path.write_text(json.dumps(asdict(card)), encoding="utf-8")
    try:
        yield
    finally:
        with contextlib.suppress(FileNotFoundError):
            path.unlink()


def card_from_text(text: str) -> EmulatorCard | None:
    """Read a card as `published` writes it; return None for anything else."""
    try:
        entries = json.loads(text)
    except (ValueError, RecursionError):
        return None
    kinds = {"bus": str, "pid": int, "imu_device": str, "io_url": str, "panel_url": str, "panel_scene": str}
    if (
        not isinstance(entries, dict)
        or {name: type(value) for name, value in entries.items()} != kinds
        or not 0 < entries["pid"] <= MAX_PID
    ):
        return None
    return EmulatorCard(**entries)


def find(bus_url: str) -> EmulatorCard | None:
    """Return the card of a running emulator on this bus, or None."""
    try:
        card = card_from_text(_card_path(bus_url).read_text(encoding="utf-8"))
        if card is None or card.bus != bus_url:
            return None
        if os.name == "posix":  # elsewhere a signal 0 is a Ctrl-C
            os.kill(card.pid, 0)
    except (OSError, ValueError):
        return None
    return card
