"""The answers of the supervisor, as the process that polls the I/O reads them."""

from __future__ import annotations

from multiprocessing.shared_memory import SharedMemory

import numpy as np

from drivers.modbus.io import IoState
from drivers.supervisor.blocks import ANSWER, OWN, PERMITS, WORD, blocks_of


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
