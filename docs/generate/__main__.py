"""Command line: `python -m docs.generate [--check]`, from the top folder of the checkout."""

from __future__ import annotations

import argparse
import sys

from docs.generate.pages import GENERATED, differences, pages


def main(arguments: list[str] | None = None) -> int:
    """Write the pages, or with --check list those that are stale, missing or orphaned; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m docs.generate", description="Write docs/generated from the code.")
    parser.add_argument("--check", action="store_true", help="Write nothing; list pages that differ, and exit with 1 if there are any.")
    check = parser.parse_args(arguments).check
    wanted = pages()
    found = differences(wanted)
    for line in found:
        print(line if check else f"{line}; written")
    if check:
        return 1 if found else 0
    GENERATED.mkdir(exist_ok=True)
    for name, text in wanted.items():
        (GENERATED / name).write_text(text, encoding="utf-8")
    for path in GENERATED.glob("*.md"):
        if path.name not in wanted:
            path.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
