"""Refuse files that are too large for the repository: `python .ci/large_files.py FILE...`."""

from __future__ import annotations

import sys
from pathlib import Path

MOST_BYTES = 500_000


def main(names: list[str]) -> int:
    """Name every file that is too large; return 1 if there is any."""
    large = [name for name in names if Path(name).is_file() and Path(name).stat().st_size > MOST_BYTES]
    for name in large:
        print(f"{name}: {Path(name).stat().st_size / 1000:.0f} kB; at most {MOST_BYTES / 1000:.0f} kB belong in the repository")
    return 1 if large else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
