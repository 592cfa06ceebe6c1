"""A version is stated alike everywhere, its changes can be read, and the public CI runs what the house runs."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import pytest
import yaml
from places import ROOT

SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
VERSION = SETTINGS["project"]["version"]
CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
FRAGMENT = re.compile(r"\+[\w-]+\.(?P<kind>\w+)\.md")
MOST_LINES = 60


def sections() -> dict[str, str]:
    """Text of every version's section of the changelog, by version and date, newest first."""
    parts = re.split(r"^## (\S+) \((\d{4}-\d\d-\d\d)\)$", CHANGELOG, flags=re.MULTILINE)[1:]
    return {f"{version} {date}": text for version, date, text in zip(parts[::3], parts[1::3], parts[2::3], strict=True)}


def test_every_place_states_the_same_version() -> None:
    newest = next(iter(sections()))
    assert newest == f"{CITATION['version']} {CITATION['date-released']}"
    assert newest.split()[0] == VERSION
    assert set(re.findall(r"isocenter-([\d.]+)-py3", (ROOT / "README.md").read_text(encoding="utf-8"))) == {VERSION}


def test_the_changes_of_a_version_can_be_read() -> None:
    assert {name: lines for name, text in sections().items() if (lines := len(text.strip().splitlines())) >= MOST_LINES} == {}


def test_a_coming_change_has_a_kind_that_the_changelog_knows() -> None:
    """And what is to come stands in the folder alone, from where it is taken."""
    kinds = {each["directory"] for each in SETTINGS["tool"]["towncrier"]["type"]}
    fragments = [path.name for path in (ROOT / SETTINGS["tool"]["towncrier"]["directory"]).iterdir() if path.name != "README.md"]
    assert [name for name in fragments if not (found := FRAGMENT.fullmatch(name)) or found["kind"] not in kinds] == []
    assert SETTINGS["tool"]["towncrier"]["start_string"] in CHANGELOG
    assert "unreleased" not in CHANGELOG.lower()


def test_the_citation_says_what_the_project_file_says() -> None:
    assert {key: CITATION[key] for key in ("cff-version", "type", "title", "license")} == {
        "cff-version": "1.2.0",
        "type": "software",
        "title": SETTINGS["project"]["name"].capitalize(),
        "license": SETTINGS["project"]["license"],
    }
    assert CITATION["message"]
    assert CITATION["authors"]
    assert [(each["type"], each["authors"][0]["family-names"]) for each in CITATION["references"]] == [("thesis", "Maas")]


@pytest.fixture
def workflow() -> dict[Any, Any]:
    return yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8"))


def test_the_public_ci_runs_the_script_of_the_house_last_and_for_every_change(workflow: dict[Any, Any]) -> None:
    assert {"push", "pull_request"} <= set(workflow[True])  # YAML 1.1 reads `on` as true
    (job,) = workflow["jobs"].values()
    assert [step["run"] for step in job["steps"] if ".ci/" in step.get("run", "")] == [job["steps"][-1]["run"]] == [".ci/run"]
    (checkout,) = (step for step in job["steps"] if step.get("uses", "").startswith("actions/checkout@"))
    assert checkout["with"]["fetch-depth"] == 0
