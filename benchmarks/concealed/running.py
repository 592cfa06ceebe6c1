"""Running the tool: its command, on recordings and a machine file, in a process of its own that has the modules (`preloaded.py`)."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from concealed.making import Places, make, seal
from concealed.preloaded import ROOT, isocenter
from hil.files.toml_text import toml_text

TIME_LIMIT_S = 900.0
CHECKED = 3
"""Of so many cases the files of one are simulated anew: it takes as long as a diagnosis."""

JSON_KEPT = ("verdict", "findings", "hypotheses", "retuned", "noise", "location", "fit", "unexplained_share", "seconds")


PACKAGES = ("hil", "virtual_bus", "controllers", "drivers")


def commit() -> str:
    """The tool's commit, marked where its files differ from it."""
    return _git("rev-parse", "HEAD") + ("+changes" if _changes() else "")


def _changes() -> str:
    return _git("status", "--porcelain", "--", *PACKAGES)


def _files() -> tuple[str, str]:
    """What the tool's files are, whatever else was committed."""
    return _git("rev-parse", *(f"HEAD:{name}" for name in PACKAGES)), _changes()


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()


@cache
def _loaded() -> tuple[str, tuple[str, str]]:
    """Commit and files when this process first ran the tool, whose modules are loaded once."""
    return commit(), _files()


def _check_unchanged() -> None:
    if _files() != _loaded()[1]:
        raise RuntimeError("the tool's files are others than when this run began: begin it again")


def run_case(places: Places, number: int, keep: bool) -> dict[str, Any]:
    """Make the case where it is not there, diagnose it, and return what is kept of the answer, with the truth's seal."""
    _check_unchanged()
    make(places, number)
    case, out = places.case(number), places.answer(number)
    out.mkdir(parents=True, exist_ok=True)
    runs = sorted(str(path) for path in case.glob("run_*.csv"))
    command = ["diagnose", str(case / "machine.toml"), *runs, "--held-out", str(case / "held_out.csv"), "-o", str(out), "--jobs", "1"]
    row: dict[str, Any] = {"number": number, "truth_sha256": seal(places.truth(number)), "commit": _loaded()[0]}
    done = isocenter(*command, limit_s=TIME_LIMIT_S)
    _check_unchanged()
    row["wall_s"] = round(done.seconds, 1)
    said = f"no answer within {TIME_LIMIT_S:g} s" if done.exit_status is None else _without_places(done.said.strip(), places)[-500:]
    row |= {"exit_status": done.exit_status, "error": said}
    answer = out / "diagnosis.json"
    if answer.exists():
        found = json.loads(answer.read_text(encoding="utf-8"))
        row["diagnosis"] = {key: found[key] for key in JSON_KEPT if key in found}
        row |= _held_out_errors(places, number, found.get("verdict", ""))
    if not keep:
        removed = case.rename(case.with_name(f"{case.name}.removed"))  # at once: half a case would be answered by an error
        shutil.rmtree(removed, ignore_errors=True)
        shutil.rmtree(out, ignore_errors=True)
    return row


def _without_places(said: str, places: Places) -> str:
    """What a command said, without the folders of the computer it ran on."""
    for folder, name in ((places.work, "WORK"), (Path(sys.prefix), "PYTHON"), (ROOT, "ISOCENTER")):
        said = said.replace(str(folder.absolute()), name).replace(str(folder), name)
    return said


def _held_out_errors(places: Places, number: int, verdict: str) -> dict[str, Any]:
    """Held-out rms per channel of the tool's re-tuned machine with and without its effects, by `isocenter simulate` and `compare`."""
    if verdict not in ("explained", "ambiguous") or number % CHECKED != 1:
        return {}
    case, out = places.case(number), places.answer(number)
    machine = out / "machine_held_out.toml"
    recorded = tomllib.loads((case / "held_out.toml").read_text(encoding="utf-8"))["machine"]["text"]
    machine.write_text(with_controllers_of(recorded, (out / "machine.toml").read_text(encoding="utf-8")), encoding="utf-8")
    errors = {}
    for name, extra in (("retuned", []), ("extended", ["--effects", str(out / "effects.toml")])):
        simulated, compared = out / f"{name}.csv", out / f"{name}.json"
        isocenter("simulate", str(machine), str(case / "held_out.csv"), "-o", str(simulated), *extra)
        isocenter("compare", str(case / "held_out.csv"), str(simulated), "--json", str(compared))
        if compared.exists():
            table = json.loads(compared.read_text(encoding="utf-8"))
            errors[name] = {channel: row["rms"] for channel, row in table["channels"].items()}
    return {"held_out_rms": errors}


def with_controllers_of(recorded: str, tuned: str) -> str:
    """The re-tuned machine file under the controllers that a recording was made with."""
    document, theirs = tomllib.loads(tuned), tomllib.loads(recorded)
    if "controller" in theirs:
        document["controller"] = theirs["controller"]
    return toml_text(document)
