"""`tcp:HOST:PORT`, as I/O devices, serial device servers and panels are named, and why nobody is reached there."""

from __future__ import annotations

import os
import re


def parse_tcp_url(url: str) -> tuple[str, int] | None:
    """Host and port, IPv6 addresses in brackets; None for anything else."""
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
    """What the system says of a connection that could not be made; name resolution counts its errors below zero."""
    number = error.errno or 0
    return os.strerror(number) if number > 0 else error.strerror or str(error)
