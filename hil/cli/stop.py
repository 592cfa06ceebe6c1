"""isocenter stop, which imports nothing that it does not need: an axis moves while it starts."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

from hil.bench.asking import ask_to_stop
from hil.errors import INTERRUPTED, in_one_line

_OPTIONS = {"--bus": "bus", "-b": "bus", "--json": "json"}


def plain_order(words: list[str]) -> tuple[str, str | None] | None:
    """Return bus and JSON file of an order to stop; None for anything that Typer has to explain."""
    given: dict[str, str] = {}
    left = [part for word in words for part in (word.split("=", 1) if word.startswith("--") else [word])]
    while left:
        option = _OPTIONS.get(left.pop(0), "")
        bare = not left or left[0].startswith("--")
        if not option or option in given or (bare and option == "bus"):
            return None
        given[option] = "-" if bare else left.pop(0)
    return (given["bus"], given.get("json")) if "bus" in given else None


def stop_at_once(bus: str, json_to: str | None) -> int:
    """Stop what runs on a bus, and return the exit status; the answer is written after the stop, so that nothing delays it."""
    said: list[str] = []

    def say(text: str) -> None:
        said.append(text)
        with contextlib.suppress(OSError):  # nobody reads any more: it waits for the stop all the same
            print(text, file=sys.stderr if json_to == "-" else sys.stdout, flush=True)

    try:
        ended = ask_to_stop(bus, say)
        if json_to is not None:
            _write({"bus": bus, "ended": ended, "seen": said}, json_to)
    except (KeyboardInterrupt, Exception) as error:
        line, status = (INTERRUPTED, 1) if isinstance(error, KeyboardInterrupt) else in_one_line(error)
        print(f"isocenter: {line}", file=sys.stderr)
        return status
    return 0


def _write(document: dict[str, object], json_to: str) -> None:
    import json

    text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
    if json_to == "-":
        sys.stdout.write(text)
    else:
        Path(json_to).write_text(text, encoding="utf-8")
