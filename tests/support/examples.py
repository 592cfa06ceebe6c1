"""How many examples a property is tried on: a quarter with every change, all by night."""

from __future__ import annotations

import os

ALL = os.environ.get("ISOCENTER_EXAMPLES") == "all"
"""Set by `.ci/nightly`."""
FEWEST = 10


def examples(by_night: int) -> int:
    """Return the number of examples to try, of those that are tried by night."""
    return by_night if ALL else min(by_night, max(FEWEST, by_night // 4))
