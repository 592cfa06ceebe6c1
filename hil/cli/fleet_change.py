"""isocenter fleet change | page: what changed over the nights of a fleet, in sentences, as data and as pages."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import working

StoreArgument = Annotated[Path, typer.Argument(metavar="STORE", help="Folder with the results of isocenter fleet run.")]
RateOption = Annotated[
    float, typer.Option("--false-alarms", metavar="RATE", help="Stated false alarms a machine and year, over all of its parameters.")
]


def register(app: typer.Typer) -> None:
    """Add the commands to `isocenter fleet`."""
    app.command(
        short_help="What changed, on which machine.",
        help="What changed on which machine, since when and how sure: a step or a growth that is the machine's own and not common to the"
        " fleet. Status 1 where a machine needs a visit.\n\nExample:  isocenter fleet change store",
    )(change)
    app.command(
        short_help="Pages: who needs a visit.",
        help="Write pages: who needs a visit, and one of every machine and parameter.\n\nExample:  isocenter fleet page store -o pages",
    )(page)


def change(store: StoreArgument, rate: RateOption = 0.01, json_to: JsonOption = None) -> None:
    """Say what changed."""
    from hil.errors import BadAnswerError
    from hil.fleet.change import fleet_change, fleet_sentence, read_tracks
    from hil.fleet.change.document import document_of
    from hil.fleet.change.sentences import common_sentences, sentences

    answer = Answer(json_to)
    with working(f"reading {store}"):
        found = fleet_change(read_tracks(store), rate)
    answer.say(fleet_sentence(found))
    for line in (*sentences(found), *common_sentences(found), *(f"note: {note}" for note in found.notes)):
        answer.say(line)
    answer.write(document_of(found))
    if found.changes:
        raise BadAnswerError(f"{store}: {fleet_sentence(found)}")


def page(
    store: StoreArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the pages; made if it is not there.")],
    rate: RateOption = 0.01,
    json_to: JsonOption = None,
) -> None:
    """Write the pages."""
    from hil.cli.options import folder_can_be_written
    from hil.fleet.change import fleet_change, fleet_sentence, read_tracks
    from hil.fleet.change.document import document_of
    from hil.fleet.pages import write_fleet_pages

    answer = Answer(json_to)
    folder_can_be_written(out)
    with working(f"reading {store}"):
        found = fleet_change(read_tracks(store), rate)
    out.mkdir(parents=True, exist_ok=True)
    with working("writing pages"):
        path = write_fleet_pages(found, str(store), out)
    answer.say(fleet_sentence(found))
    answer.say(f"{path}: pages of {len(found.tracks.machines)} machines and {len(found.tracks.parameters)} parameters beside it")
    answer.write({"page": path, **document_of(found)})
