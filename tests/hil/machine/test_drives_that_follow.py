"""The C-arm with drives that close loops of their own: the shipped files, and the page that shows their gains."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import pytest
from places import ROOT

from hil.machine import load_machine
from hil.machine.check import check_machine, failing_controllers
from hil.machine.load import machine_from_text

MODES = {"carm-csp": "position", "carm-csv": "velocity"}
PAGE = ROOT / "docs" / "how-to" / "drive-modes.md"


@pytest.mark.slow
@pytest.mark.parametrize("name", MODES)
def test_every_check_passes_at_every_pose(name: str) -> None:
    findings = check_machine(load_machine(name))
    assert [finding.text for finding in findings if not finding.ok] == []
    (stability,) = [finding for finding in findings if finding.name == "stability"]
    assert stability.values["poses"] == 81


@pytest.mark.parametrize("name", MODES)
def test_they_are_the_c_arm_but_for_loops_controllers_and_what_the_drives_receive(name: str) -> None:
    plain, other = (tomllib.loads(load_machine(each).text) for each in ("carm", name))
    for machine in (plain, other):
        for key in ("name", "description", "controller"):
            del machine[key]
        for axis in ("propeller", "roll"):
            assert (machine["drives"][axis].pop("mode", None), "loops" in machine["drives"][axis]) in ((None, False), (MODES[name], True))
            machine["drives"][axis].pop("loops", None)
            (rpdo,) = machine["bus"]["nodes"][f"{axis}_drive"]["rpdo"]
            wanted = ["target_torque"] if machine is plain else [f"target_{MODES[name]}", "torque_offset"]
            assert rpdo.pop("map") == ["controlword", *wanted]
    assert other == plain


def shown() -> dict[str, Any]:
    (block,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return tomllib.loads(block)


def test_the_page_shows_the_gains_of_the_shipped_file() -> None:
    shipped = tomllib.loads(load_machine("carm-csp").text)
    assert shown()["drives"]["roll"]["loops"] == shipped["drives"]["roll"]["loops"]
    (rpdo,) = shown()["bus"]["nodes"]["roll_drive"]["rpdo"]
    assert rpdo == shipped["bus"]["nodes"]["roll_drive"]["rpdo"][0]
    assert "isocenter machine check carm-csp" in PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("lacks", "fails"),
    [(("torque_sections",), "margin"), (("speed_filter",), "margin"), (("torque_sections", "speed_filter"), "stability")],
)
def test_without_notch_and_filter_it_is_unstable_and_without_one_its_margins_fail(lacks: tuple[str, ...], fails: str) -> None:
    text = load_machine("carm-csp").text
    for key in lacks:
        text, replaced = re.subn(rf"(?m)^{key} = (\[\n.*\n\]|.*)\n", "", text)
        assert replaced == 2
    assert any(finding.name.endswith(fails) for finding in failing_controllers(machine_from_text(text), poses=9))
