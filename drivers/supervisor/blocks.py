"""The shared memory of the supervisor: a block that it writes, and one with the orders of the loop."""

from __future__ import annotations

import struct
from multiprocessing.shared_memory import SharedMemory

from drivers.modbus.shared_block import Block

ROUNDS, SESSION, PERMITS, WORD, ANSWER, ASKED, OWN = range(7)
"""Its count of rounds, the session, its permission, the word that it has answered, the answer, and whether somebody asked for a stop."""
WANTED_SESSION, END, ORDERS = range(3)
"""The session that the loop wants, and whether the supervisor is to end."""
FRAME = struct.Struct("<IB8s")
"""A frame that the bus's owner passes on: identifier, length, data."""


def blocks_of(memory: SharedMemory) -> tuple[Block, Block]:
    """Return the blocks of the supervisor and of the loop."""
    buffer = memory.buf
    assert buffer is not None, "shared memory was closed"
    split = Block.bytes(OWN)
    return Block(buffer[:split], OWN), Block(buffer[split:], ORDERS)
