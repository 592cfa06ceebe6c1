"""The shared memory of the supervisor: its own block with its answers, as the I/O's poller reads them, and one of the loop's orders."""

from __future__ import annotations

import struct
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from drivers.shared_memory.block import Block
from drivers.shared_memory.io_state import IoState

ROUNDS, SESSION, PERMITS, WORD, ANSWER, ASKED, OWN = range(7)
"""Its count of rounds, the session, its permission, the word that it has answered, the answer, and whether somebody asked for a stop."""
WANTED_SESSION, END, TICK_S, ORDERS = range(4)
"""The session that the loop wants, whether the supervisor is to end, and when a tick of the loop was, by the clock of all processes; before
the first, 0."""
FRAME = struct.Struct("<IB8s")
"""A frame that the bus's owner passes on: identifier, length, data."""


def blocks_of(memory: SharedMemory) -> tuple[Block, Block]:
    """Return the blocks of the supervisor and of the loop."""
    buffer = memory.buf
    assert buffer is not None, "shared memory was closed"
    split = Block.bytes(OWN)
    return Block(buffer[:split], OWN), Block(buffer[split:], ORDERS)


class AnswerReader:
    """The poller's view of the supervisor: the word that follows the one the device shows, where it was given.

    Parameters
    ----------
    memory_name : str
    """

    def __init__(self, memory_name: str) -> None:
        self._memory = SharedMemory(name=memory_name)
        self._own, self._orders = blocks_of(self._memory)
        self._seen = np.zeros(OWN)

    def __call__(self, state: IoState) -> int | None:
        """Return the word that the supervisor has given for the one shown, or None."""
        if self._own.read(self._seen) < 0 or not self._seen[PERMITS] or self._seen[WORD] != state.word:
            return None
        return int(self._seen[ANSWER])

    def close(self) -> None:
        """Release the memory."""
        self._own.release()
        self._orders.release()
        self._memory.close()
