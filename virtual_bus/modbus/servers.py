"""The emulated I/O device on a TCP port or a pseudo terminal, each served by a thread of its own beside the emulator."""

from __future__ import annotations

import socketserver
import threading

from virtual_bus.errors import EmulatorError
from virtual_bus.modbus.framing import TcpFraming
from virtual_bus.modbus.io_device import EmulatedIo
from virtual_bus.serial.pty import Pty

READ_BYTES = 4096
RTU_SILENCE_S = 0.00175  # ends a frame; the fixed value above 19200 baud (Modbus over Serial Line V1.02, sec. 2.5.1.1)
STOP_CHECK_S = 0.1  # how often a server looks whether it should end


class _Connection(socketserver.BaseRequestHandler):
    """One client: requests in, answers out, until it hangs up or speaks something else."""

    server: _TcpServer

    def handle(self) -> None:
        framing = TcpFraming()
        while not framing.broken:
            try:
                data = self.request.recv(READ_BYTES)
                if not data:
                    return
                self.request.sendall(self.server.device.serve_tcp(framing, data))
            except OSError:
                return


class _TcpServer(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, address: tuple[str, int], device: EmulatedIo) -> None:
        self.device = device
        super().__init__(address, _Connection)


class ModbusTcpServer:
    """The device on `host:port`; port 0 takes any free one.

    Raises
    ------
    EmulatorError
        The port is in use or may not be opened.
    """

    def __init__(self, device: EmulatedIo, host: str = "127.0.0.1", port: int = 0) -> None:
        try:
            self._server = _TcpServer((host, port), device)
        except OSError as error:
            raise EmulatorError(f"Modbus TCP on {host}:{port}: {error.strerror}; give another port, or 0 for any that is free") from error
        self.host = host
        self.port = int(self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, args=(STOP_CHECK_S,), name="modbus-tcp", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """As the bench names it."""
        return f"tcp:{self.host}:{self.port}"

    def close(self) -> None:
        """Stop serving and give the port back."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class ModbusRtuServer:
    """The device on a pseudo terminal; what arrives between two silences is one frame."""

    def __init__(self, device: EmulatedIo) -> None:
        self._device = device
        self._pty = Pty()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="modbus-rtu", daemon=True)
        self._thread.start()

    @property
    def device(self) -> str:
        """The port the bench opens."""
        return self._pty.path

    def _serve(self) -> None:
        while not self._stop.is_set():
            if not self._pty.wait(STOP_CHECK_S):
                continue
            frame = self._pty.read()
            while self._pty.wait(RTU_SILENCE_S):
                frame += self._pty.read()
            self._pty.write(self._device.serve_rtu(frame))

    def close(self) -> None:
        """Stop serving and hang up."""
        self._stop.set()
        self._thread.join()
        self._pty.close()
