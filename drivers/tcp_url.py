"""Addresses `tcp:HOST:PORT` of I/O devices, serial device servers and panels, and the reason why one is not reached."""

from __future__ import annotations

import os
import re


def parse_tcp_url(url: str) -> tuple[str, int] | None:
    """Return host and port, IPv6 addresses in brackets; None for anything else."""
    match = re.fullmatch(r"tcp:(\[[^\s\[\]]+\]|[^\s\[\]]+):([0-9]{1,5})", url)
    if match is None or not 0 < int(match[2]) <= 0xFFFF:
        return None
    host = match[1].strip("[]")
    try:
        host.encode("idna")
    except UnicodeError:  # a label that is empty or longer than 63 characters: no name can be looked up by it
        return None
    return host, int(match[2])


def why_not_reached(error: OSError) -> str:
    """Return the system's reason for a failed connection; errors of name resolution have negative numbers."""
    number = error.errno or 0
    return os.strerror(number) if number > 0 else error.strerror or str(error)
