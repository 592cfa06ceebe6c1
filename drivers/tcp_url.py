"""`tcp:HOST:PORT`, as I/O devices and serial device servers are named."""

from __future__ import annotations

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
