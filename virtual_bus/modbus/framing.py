"""Modbus requests on TCP and on a serial line.

Written from the specifications, apart from the library the drivers use, so that the two ends check each other. Sources: Modbus Messaging on
TCP/IP Implementation Guide V1.0b, sec. 3.1.3; Modbus over Serial Line V1.02, secs. 2.5.1 and 6.2.2.
"""

from __future__ import annotations

import struct

MBAP = struct.Struct(">HHHB")
MBAP_BYTES = MBAP.size
MODBUS_PROTOCOL = 0
MAX_PDU_BYTES = 253
RTU_MIN_BYTES = 4
RTU_MAX_BYTES = 256


class TcpFraming:
    """Cuts a TCP stream into requests.

    A header that is no Modbus header means that the stream is lost: `broken` turns True and the connection should be closed.
    """

    def __init__(self) -> None:
        self._begun = b""  # of a request that is not complete
        self.broken = False

    def feed(self, data: bytes) -> list[tuple[int, int, bytes]]:
        """Add received bytes and return the requests that are complete, each as (transaction, unit id, PDU)."""
        data, start, requests = self._begun + data, 0, []
        while len(data) - start >= MBAP_BYTES and not self.broken:
            transaction, protocol, length, unit_id = MBAP.unpack_from(data, start)
            if protocol != MODBUS_PROTOCOL or not 2 <= length <= MAX_PDU_BYTES + 1:
                self.broken = True
                break
            end = start + MBAP_BYTES - 1 + length
            if len(data) < end:
                break
            requests.append((transaction, unit_id, data[start + MBAP_BYTES : end]))
            start = end
        self._begun = data[start:]
        return requests


def tcp_frame(transaction: int, unit_id: int, pdu: bytes) -> bytes:
    """Return a PDU behind its TCP header."""
    return MBAP.pack(transaction, MODBUS_PROTOCOL, len(pdu) + 1, unit_id) + pdu


def crc16(data: bytes) -> int:
    """Return the check of the serial line: polynomial 0xA001 reflected, start 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def rtu_frame(unit_id: int, pdu: bytes) -> bytes:
    """Return a PDU between address and check, low byte first."""
    frame = bytes((unit_id,)) + pdu
    return frame + struct.pack("<H", crc16(frame))


def rtu_request(frame: bytes) -> tuple[int, bytes] | None:
    """Return (unit id, PDU) of what arrived between two silences.

    None when it is too short, too long or damaged.
    """
    if not RTU_MIN_BYTES <= len(frame) <= RTU_MAX_BYTES or crc16(frame[:-2]) != int.from_bytes(frame[-2:], "little"):
        return None
    return frame[0], frame[1:-2]
