"""Asking the bench that runs on a bus to stop, from any process of this user on this host, by way of its supervisor."""

from __future__ import annotations

import contextlib
import getpass
import hashlib
import os
import socket
import stat
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from drivers.bus_url import parse_bus_url, split_bus_url
from hil.errors import BadAnswerError, NothingRunsError
from hil.processes.private_folder import check_own, made_private_folder, private_folder

ANSWER_S = 1.0  # a supervisor answers within a period
STOP_S = 15.0
"""Longest time that is waited for the drives' torque to go: a stop with all its proofs takes ten seconds at most. Then a drive holds."""
AGAIN_S = 0.2
NO_TORQUE, HELD, BENCH_ENDED = "no torque", "held", "bench ended"
"""How a stop ended; the first two are a supervisor's words."""


def stop_socket(bus_url: str, *, make: bool = False) -> Path:
    """Return the socket at which the supervisor on a bus takes questions for a stop; `make` its folder where it is not there.

    Raises
    ------
    UnusableInputError
        The folder is not this user's own.
    """
    folder = made_private_folder() if make else private_folder()
    bus = split_bus_url(bus_url)
    name = f"{bus.interface}:{bus.channel}:{bus.options}"
    return folder / f"stop-{hashlib.sha256(name.encode()).hexdigest()[:16]}.socket"


def ask_to_stop(bus_url: str, say: Callable[[str], None], asker: str = "`isocenter stop`") -> str:
    """Ask for a stop, and stay until no drive has torque, or those that have hold their axes when every proof should be over.

    Parameters
    ----------
    bus_url : str
    say : callable
        Takes a line of what is seen.
    asker : str
        Who asks, for the audit trail.

    Returns
    -------
    str
        How it ended: "no torque", "held" or "bench ended".

    Raises
    ------
    NothingRunsError
        No bench of this user runs on the bus.
    BadAnswerError
        A drive keeps its torque and does not hold, or nobody knows.
    """
    path = stop_socket(bus_url)
    who = f"{asker} (user {_user()}, process {os.getpid()})"
    with contextlib.ExitStack() as held:
        line = held.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        silent = "the supervisor does not answer"
        try:
            line.bind(str(Path(held.enter_context(tempfile.TemporaryDirectory())) / "answers"))
        except OSError as error:  # it hears all the same
            silent = f"the supervisor cannot answer, which needs a socket in a temporary folder ({error})"
        line.settimeout(ANSWER_S)
        seen = _ask(line, path, who)
        if seen is None:
            parse_bus_url(bus_url)  # which may say that there is no such bus
            raise NothingRunsError(f"{bus_url}: no bench of yours runs on this bus; stop the machine at its emergency stop")
        if not seen:
            raise BadAnswerError(f"{bus_url}: {silent}; stop the machine at its emergency stop")
        say(f"{bus_url}: the supervisor was told")
        give_up = time.monotonic() + STOP_S
        while seen is not None and not seen.startswith(NO_TORQUE):
            if not seen:
                raise BadAnswerError(f"{bus_url}: the supervisor answers no more; nobody knows whether the motors stand")
            if time.monotonic() > give_up:
                if seen.startswith(HELD):
                    say(f"{bus_url}: a drive holds its axis, whose brake is not proven; the terminal of the run says how to release it")
                    return HELD
                raise BadAnswerError(
                    f"{bus_url}: a drive has torque and does not hold, or tells nothing, after {STOP_S:g} s; stop the machine at its "
                    "emergency stop"
                )
            time.sleep(AGAIN_S)
            seen = _ask(line, path, who)
    say(f"{bus_url}: " + ("the bench has ended" if seen is None else "no drive has torque"))
    return BENCH_ENDED if seen is None else NO_TORQUE


def _user() -> str:
    """Return the user's name, or number where the computer knows no name, as in a container."""
    try:
        return getpass.getuser()
    except (ImportError, KeyError, OSError):
        return str(os.getuid())


def _ask(line: socket.socket, path: Path, who: str) -> str | None:
    """Return what the supervisor sees; None where there is none, '' where it does not answer."""
    try:
        check_own(path.parent, path.parent.lstat(), stat.S_ISDIR)
        line.sendto(who.encode(), str(path))
    except FileNotFoundError:
        return None
    except OSError:
        return ""
    with contextlib.suppress(OSError):
        return line.recv(1000).decode(errors="replace")
    return ""
