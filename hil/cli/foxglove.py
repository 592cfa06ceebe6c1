"""isocenter foxglove: recordings live in Foxglove while they are made."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption

LOOPBACK = "127.0.0.1"


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Recordings live in Foxglove.",
        help="Serve rows to Foxglove (Open connection, Foxglove WebSocket) as they are recorded, by reading the recorder's file: start it"
        " in a second terminal. In a folder it goes on until Ctrl-C; of one recording it ends with it."
        "\n\nExample:  isocenter foxglove run.mf4"
        "\n\nExample:  isocenter foxglove . --port 8765",
    )(foxglove)


def foxglove(
    place: Annotated[Path, typer.Argument(metavar="REC|FOLDER", help="A recording to be, or a folder of recordings.")] = Path("."),
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="TCP port; 0 takes a free one.")] = 8765,
    host: Annotated[
        str, typer.Option("--host", help="Address to listen on. Any other than the loopback lets the network read the recordings.")
    ] = LOOPBACK,
    json_to: JsonOption = None,
) -> None:
    """Serve until the end."""
    from hil.recording.foxglove_live import FoxgloveServer, serve
    from hil.recording.journal import part_path

    answer = Answer(json_to)
    if not place.is_dir() and place.exists() and not part_path(place).exists():
        shown = place.with_suffix(".mcap")
        raise UnusableInputError(f"{place}: has ended; Foxglove opens `isocenter convert {place} {shown}`")
    if not (place if place.is_dir() else place.absolute().parent).is_dir():
        raise UnusableInputError(f"{place}: its folder does not exist")
    server = FoxgloveServer(host, port)
    try:
        answer.say(f"ws://{host}:{server.port}: waits for a recording {'in' if place.is_dir() else 'named'} {place}; Ctrl-C ends it")
        if host != LOOPBACK:
            answer.say("it asks nobody for a password: whoever reaches this port reads along")
        answer.write_at_once({"url": f"ws://{host}:{server.port}", "place": place})
        serve(place, server, answer.say)
    finally:
        server.close()
