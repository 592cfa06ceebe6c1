"""The socket of a supervisor at which stops are asked for, without the supervisor."""

from __future__ import annotations

import socket
import threading

from hil.bench import asking


class Supervisor:
    """Answers each question with the next of some texts."""

    def __init__(self, bus: str, *texts: str) -> None:
        self.heard: list[str] = []
        self._bus, self._texts = bus, texts
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(asking.stop_socket(bus, make=True)))
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        for text in self._texts:
            words, sender = self._socket.recvfrom(1000)
            self.heard.append(words.decode())
            self._socket.sendto(text.encode(), sender)
        self._socket.close()
        asking.stop_socket(self._bus).unlink()

    def end(self) -> None:
        """Wait until every text was told."""
        self._thread.join(10.0)
