"""Files in which emulators on this host announce the ports of IMU, I/O and panel beside their CAN bus, for `run --bus URL`.

A real machine needs none of this: its serial device and I/O address are in the machine file or on the command line.

A bench believes a card when it opens brakes at the address in it. So cards lie in a folder that only their user can enter, and a folder or
card that somebody else owns, or can write to, or has put a link in place of, is refused.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from hil.errors import UnusableInputError

MAX_PID = 2**31 - 1
FOLDER_MODE, CARD_MODE = 0o700, 0o600
MOST_BYTES = 16_384  # some addresses; anything longer is no card
REMEDY = "set XDG_RUNTIME_DIR to a folder of your own"
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
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


def _folder() -> Path:
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(base) / f"isocenter-{os.getuid() if hasattr(os, 'getuid') else 'user'}"


def _card_path(bus_url: str) -> Path:
    return _folder() / f"{hashlib.sha256(bus_url.encode()).hexdigest()[:16]}.json"


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
        path.parent.mkdir(mode=FOLDER_MODE, parents=True, exist_ok=True)
        _check_own(path.parent, path.parent.lstat(), stat.S_ISDIR)
        fresh = path.with_suffix(f".{card.pid}")
        fresh.unlink(missing_ok=True)
        with os.fdopen(os.open(fresh, _NEW, CARD_MODE), "w", encoding="utf-8") as file:
            file.write(json.dumps(asdict(card)))
        fresh.replace(path)
    except OSError as error:
        raise UnusableInputError(f"{path}: the emulator's card cannot be written: {error.strerror}; {REMEDY}") from None
    try:
        yield
    finally:
        with contextlib.suppress(FileNotFoundError):
            path.unlink()


def _check_own(path: Path, status: os.stat_result, is_kind: Callable[[int], bool]) -> None:
    """Raise UnusableInputError where somebody else may have made this folder or card, or may change it."""
    if not hasattr(os, "getuid"):
        return  # Windows: the user's temporary folder is closed to others
    if stat.S_ISLNK(status.st_mode) or not is_kind(status.st_mode):
        wrong = "is a link or no folder" if is_kind is stat.S_ISDIR else "is a link or no file"
    elif status.st_uid != os.getuid():
        wrong = f"belongs to user {status.st_uid}, not to you ({os.getuid()})"
    elif status.st_mode & _WRITABLE_BY_OTHERS:
        wrong = f"can be written by others (mode {stat.S_IMODE(status.st_mode):o})"
    else:
        return
    raise UnusableInputError(f"{path}: {wrong}, so what it says of an emulator's addresses is not believed; remove it, or {REMEDY}")


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
    _check_own(path.parent, path.parent.lstat(), stat.S_ISDIR)
    _check_own(path, status, stat.S_ISREG)
    try:
        with os.fdopen(os.open(path, _OLD), "rb") as file:
            _check_own(path, os.fstat(file.fileno()), stat.S_ISREG)
            card = card_from_text(file.read(MOST_BYTES).decode())
        if card is None or card.bus != bus_url:
            return None
        if os.name == "posix":  # elsewhere a signal 0 is a Ctrl-C
            os.kill(card.pid, 0)
    except (OSError, ValueError):
        return None
    return card
