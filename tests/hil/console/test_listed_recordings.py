"""The folder of the bench as the page lists it."""

from __future__ import annotations

import json
from pathlib import Path

from hil.console.files import Listing


def test_a_recording_is_listed_with_its_experiment_and_apart_from_what_was_made_of_it(tmp_path: Path) -> None:
    for name in ("still.mf4", "tour-1.mf4", "brought.csv", "plot.html"):
        (tmp_path / name).write_text("")
    told = {"recordings": [{"recording": str(tmp_path / "still.mf4"), "experiment": {"kind": "static"}}]}
    (tmp_path / "still.json").write_text(json.dumps(told))
    (tmp_path / "other.json").write_text("[1, 2")
    listing = Listing(tmp_path)
    found = {each["name"]: each for each in listing.entries()}
    assert {name: each["experiment"] for name, each in found.items() if each["kind"] == "recording"} == {
        "still.mf4": "static",
        "tour-1.mf4": "",
        "brought.csv": "",
    }
    assert "experiment" not in found["plot.html"]
    told["recordings"].append({"recording": str(tmp_path / "tour-1.mf4"), "experiment": {"kind": "tour"}})
    (tmp_path / "still.json").write_text(json.dumps(told))
    assert {each["name"]: each.get("experiment") for each in listing.entries()}["tour-1.mf4"] == "tour"
