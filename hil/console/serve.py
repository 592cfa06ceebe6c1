"""The two processes of `isocenter bench`: the starter, which is the one that calls `serve`, and the server beside it."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType

from hil.console.admission import Admission
from hil.console.facts import Facts
from hil.console.guard import ENTRANCE, MOST_BYTES, Hosts
from hil.console.starter import Starter
from hil.errors import BadAnswerError, UnusableInputError
from hil.processes.second_in_line import PROMPT, politely

CLOSES_S = 2
END_S = 10.0
START_S = 120.0
"""Longest time for a new Python process on a loaded computer."""
BACKLOG = 64
WILDCARDS = ("0.0.0.0", "::")
"""Addresses to listen at that no browser on another computer can open."""


@dataclass(frozen=True)
class Place:
    """Where the server listens, and who is let in."""

    host: str
    port: int
    token: str

    def check(self) -> None:
        """Refuse a token that could be guessed.

        Raises
        ------
        UnusableInputError
        """
        Admission(self.token)

    def bind(self) -> socket.socket:
        """Return a socket that listens there.

        Raises
        ------
        UnusableInputError
            The address is not this computer's, or the port is taken.
        """
        self.check()
        try:
            family, _, _, _, address = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
            listening = socket.socket(family, socket.SOCK_STREAM)
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(address)
            listening.listen(BACKLOG)
        except OSError as error:
            raise UnusableInputError(
                f"--host {self.host} --port {self.port}: cannot listen there: {error.strerror}; --port 0 takes any free port"
            ) from None
        return listening

    def address(self, listening: socket.socket) -> str:
        """Return what a user opens."""
        host = socket.gethostname() if self.host in WILDCARDS else f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{listening.getsockname()[1]}{ENTRANCE}?token={self.token}"


def serve(facts: Facts, folder: Path, place: Place, ready: Callable[[str], None]) -> None:
    """Serve until Ctrl-C, or until the server has ended; what runs then is stopped first, motors before anything else.

    Parameters
    ----------
    facts : Facts
    folder : Path
        Where runs record.
    place : Place
    ready : callable
        Takes the address to open, once the server listens.
    """
    listening = place.bind()
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    server = context.Process(
        target=politely,
        args=(_serve_pages, facts, folder, place, listening, theirs),
        kwargs={"niceness": PROMPT},  # it takes STOP and judges whether the browser is there: no other load may keep it from that
        name="isocenter-bench-server",
        daemon=True,
    )
    server.start()
    theirs.close()
    told: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        told.append(number)

    ending = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {number: signal.signal(number, end) for number in ending}
    if hasattr(signal, "SIGTTIN"):
        before[signal.SIGTTIN] = signal.signal(signal.SIGTTIN, signal.SIG_IGN)  # a read from the background must fail, not suspend
    try:
        if not _heard_of(ours):
            raise BadAnswerError(f"the server of the page did not start within {START_S:g} s, or has failed")
        ready(place.address(listening))
        listening.close()
        Starter(ours).serve(lambda: not told)
    finally:
        ours.close()
        server.join(END_S)
        server.kill()
        for number, handler in before.items():
            signal.signal(number, handler)


def _heard_of(line: Connection) -> bool:
    """Wait for the first word of the server, which it says once it answers."""
    try:
        return line.poll(START_S) and bool(line.recv())
    except (EOFError, OSError):
        return False


def _serve_pages(facts: Facts, folder: Path, place: Place, listening: socket.socket, line: Connection) -> None:
    """Run the server's process; it ends when the starter does, since its page may be needed until what runs has ended."""
    import uvicorn

    from hil.console.app import application
    from hil.console.desk import Desk

    class Server(uvicorn.Server):
        @contextlib.contextmanager
        def capture_signals(self) -> Iterator[None]:
            """Leave Ctrl-C to the starter."""
            yield

    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    app = application(Desk(facts, folder, line), Admission(place.token), Hosts(place.host))
    config = uvicorn.Config(
        app,
        log_level="critical",
        access_log=False,
        server_header=False,
        ws_max_size=MOST_BYTES,
        ws_per_message_deflate=False,  # rows are numbers, which shrink little and cost much
        h11_max_incomplete_event_size=MOST_BYTES,
        timeout_graceful_shutdown=CLOSES_S,
        limit_concurrency=64,
        proxy_headers=False,
    )
    Server(config).run(sockets=[listening])
