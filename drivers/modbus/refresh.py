"""The word that keeps the outputs of an I/O device on: a rule that the device and the supervisor know, and whoever carries it does not.

The device shows a word in a holding register. Only the word that follows it, written to the same register, is accepted; it is then the one
shown. A carrier that repeats or keeps a word refreshes nothing.
"""

from __future__ import annotations

WORD_BITS = 16
_MASK = (1 << WORD_BITS) - 1
FIRST_WORD = 0x1D0C
"""Shown by a device that was switched on; any word but zero would do."""


def following_word(word: int) -> int:
    """Return the word that follows: a step of a xorshift generator of full period 65,535 (Marsaglia 2003, with shifts 7, 9 and 8).

    Zero, which no device shows, follows itself.
    """
    word ^= word << 7 & _MASK
    word ^= word >> 9
    return word ^ (word << 8 & _MASK)
