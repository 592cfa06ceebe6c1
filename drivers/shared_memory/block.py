"""A block of numbers and a line of text in shared memory that one process writes and others read without locks.

The writer changes it between two increments of its sequence number, so that a reader can tell a block that was changed under its eyes.
"""

from __future__ import annotations

import numpy as np

ERROR_BYTES = 512
READ_ATTEMPTS = 100


class Block:
    """Some float64 values and a line of text in shared memory, with one writer and any number of readers."""

    def __init__(self, memory: memoryview, values: int) -> None:
        self._sequence = np.frombuffer(memory, np.int64, 1)
        self._values = np.frombuffer(memory, np.float64, values, 8)
        self._text = np.frombuffer(memory, np.uint8, ERROR_BYTES, 8 + 8 * values)
        self._written = ""

    @staticmethod
    def bytes(values: int) -> int:
        """Return the size in memory."""
        return 8 + 8 * values + ERROR_BYTES

    @property
    def sequence(self) -> int:
        """Sequence number, which grows with every write; it is even while nobody writes."""
        return int(self._sequence[0])

    def write(self, values: np.ndarray, text: str = "") -> None:
        """Replace the content."""
        self._sequence[0] += 1
        self._values[:] = values
        if text != self._written:
            encoded = text.encode()[:ERROR_BYTES]
            self._text[: len(encoded)] = np.frombuffer(encoded, np.uint8)
            self._text[len(encoded) :] = 0
            self._written = text
        self._sequence[0] += 1

    def read(self, into: np.ndarray) -> int:
        """Copy the values; return their sequence number, or -1 when the writer was active at every attempt."""
        for _ in range(READ_ATTEMPTS):
            before = self.sequence
            into[:] = self._values
            if before == self.sequence and before % 2 == 0:
                return before
        return -1

    @property
    def text(self) -> str:
        """The line of text."""
        for _ in range(READ_ATTEMPTS):
            before = self.sequence
            encoded = self._text.tobytes()
            if before == self.sequence and before % 2 == 0:
                return encoded.rstrip(b"\0").decode(errors="replace")
        return ""

    def release(self) -> None:
        """Release the memory, so that it can be closed."""
        del self._sequence, self._values, self._text
