"""Files in which emulators on this host announce the ports of IMU, I/O and panel beside their CAN bus, for `run --bus URL`.

A real machine needs none of this: its serial device and I/O address are in the machine file or on the command line.

A bench believes a card when it opens brakes at the address in it. So cards lie in a folder that only their user can enter, and a folder or
card that somebody else owns, or can write to, or has put a link in place of, is refused. An emulator holds its card for as long as it
lives; one that nobody holds was left by an emulator that was killed, whoever has its process number now.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import stat
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from hil.errors import UnusableInputError
from hil.files.held import hold, is_held
from hil.processes.private_folder import REMEDY, check_own, made_private_folder, private_folder

MAX_PID = 2**31 - 1
CARD_MODE = 0o600
MOST_BYTES = 16_384  # some addresses; anything longer is no card
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)
_OLD = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # a pipe in its place must not be waited for


@dataclass(frozen=True)
class EmulatorCard:
    """The ports that an emulator announces."""

    bus: str
    pid: int
    imu_device: str  # tcp:HOST:PORT; "" when the machine has no IMU
    io_url: str  # "" when it has no I/O
    panel_url: str = ""  # "" when it has no panel
    panel_scene: str = ""  # the objects in that panel's beam


def _card_path(bus_url: str) -> Path:
    return private_folder() / f"{hashlib.sha256(bus_url.encode()).hexdigest()[:16]}.json"


@contextlib.contextmanager
def published(card: EmulatorCard) -> Iterator[None]:
    """Publish a card for the length of the block.

    Raises
    ------
    UnusableInputError
        The folder for cards is not this user's own, or cannot be made.
    """
    path = _card_path(card.bus)
    try:
        made_private_folder()
        fresh = path.with_suffix(f".{card.pid}")
        fresh.unlink(missing_ok=True)
        file = os.fdopen(os.open(fresh, _NEW, CARD_MODE), "w", encoding="utf-8")
        hold(file.fileno())
        file.write(json.dumps(asdict(card)))
        file.flush()
        fresh.replace(path)
    except OSError as error:
        raise UnusableInputError(f"{path}: the emulator's card cannot be written: {error.strerror}; {REMEDY}") from None
    with file:
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
    """Return the card of a running emulator on this bus, or None.

    Raises
    ------
    UnusableInputError
        There is a card that somebody else may have written.
    """
    path = _card_path(bus_url)
    try:
        status = path.lstat()
    except OSError:
        return None
    check_own(path.parent, path.parent.lstat(), stat.S_ISDIR)
    check_own(path, status, stat.S_ISREG)
    try:
        with os.fdopen(os.open(path, _OLD), "rb") as file:
            check_own(path, os.fstat(file.fileno()), stat.S_ISREG)
            card = card_from_text(file.read(MOST_BYTES).decode()) if is_held(file) else None
        if card is None or card.bus != bus_url:
            return None
    except (OSError, ValueError):
        return None
    return card
