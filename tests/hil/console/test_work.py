"""Orders, forms and attention, apart from the web."""

from __future__ import annotations

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from hil.bench.attendant import Operator
from hil.console import starter
from hil.console.attention import AWAY_S, SILENT_S, Attention
from hil.console.commands import Answers, Command, Order, run_command
from hil.console.facts import Facts, facts_of
from hil.console.forms import forms_of
from hil.console.preview import preview
from hil.console.steps import missing_before, steps_of
from hil.console.verdicts import scan
from hil.console.work import Work
from hil.errors import UnusableInputError
from hil.experiments import Scan, experiment_from_text
from hil.machine import Machine, load_machine


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


@pytest.fixture
def facts(carm: Machine) -> Facts:
    return facts_of("carm", carm, "udp:")


class Line:
    """A starter that only listens."""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send(self, obj: object) -> None:
        self.sent.append(obj)


@pytest.fixture
def line() -> Line:
    return Line()


@pytest.fixture
def work(line: Line, tmp_path: Path) -> Work:
    return Work(line, tmp_path, lambda order, passed: None)


def command(key: str, *arguments: str, moves: bool = False) -> Command:
    return Command(key, lambda answers: [*arguments], moves)


def answer(folder: Path, key: str, what: object) -> None:
    (folder / f"{key}.json").write_text(json.dumps(what))


def test_commands_follow_one_another_and_know_the_answers_before(work: Work, line: Line, tmp_path: Path) -> None:
    second = Command("b", lambda answers: ["identify", answers["a"]["recording"]])
    work.begin(Order("Both", (command("a", "run", moves=True), second), judge=lambda answers: (True, f"b is {answers['b']}")), "me")
    assert line.sent == [(starter.RUN, ["run", "--json", str(tmp_path / "a.json")])]
    assert work.moves
    answer(tmp_path, "a", {"recording": "ms.mf4"})
    work.heed(starter.ENDED, 0)
    assert line.sent[-1] == (starter.RUN, ["identify", "ms.mf4", "--json", str(tmp_path / "b.json")])
    assert not work.moves  # nothing does now, so nobody must answer
    assert not work.state_now()["moves"]  # what is computed last is not told as a motion
    answer(tmp_path, "b", 5)
    work.heed(starter.ENDED, 0)
    assert (work.state, work.why) == ("passed", "b is 5")


def test_the_newest_line_of_progress_is_told_and_none_is_kept(work: Work, tmp_path: Path) -> None:
    work.begin(Order("A", (command("a", "diagnose"),)), "me")
    for text in ("... fitting: 5 s", "... fitting: 10 s"):
        work.heed(starter.SAID, text, True)
    assert work.state_now()["progress"] == "fitting: 10 s"
    assert [text for text, _ in work.lines] == ["$ isocenter diagnose"]
    work.heed(starter.ENDED, 1)
    assert work.state_now()["progress"] == ""


def test_a_command_that_fails_ends_the_order_and_says_why(work: Work, line: Line) -> None:
    work.begin(Order("Both", (command("a", "run"), command("b", "identify"))), "me")
    work.heed(starter.SAID, "carm: booting", True)
    work.heed(starter.SAID, "isocenter: node 1 does not answer", True)
    work.heed(starter.ENDED, 1)
    assert (work.state, work.why) == ("failed", "node 1 does not answer")
    assert len(line.sent) == 1


@pytest.mark.parametrize("status", [0, 1])
def test_a_bad_answer_is_no_failure_and_says_its_own_sentence(work: Work, tmp_path: Path, status: int) -> None:
    work.begin(Order("Check", (command("check", "machine"),), judge=lambda answers: (False, "2 fail: roll has no brake")), "me")
    answer(tmp_path, "check", {})
    work.heed(starter.ENDED, status)
    assert (work.state, work.why) == ("bad", "2 fail: roll has no brake")


@pytest.mark.parametrize("error", [TypeError("no list"), KeyError("observer"), RuntimeError("odd")])
def test_an_answer_that_cannot_be_judged_ends_the_work_as_failed(work: Work, tmp_path: Path, error: Exception) -> None:
    def judge(answers: Answers) -> tuple[bool, str]:
        raise error

    work.begin(Order("A", (command("a", "run", moves=True),), judge=judge), "me")
    answer(tmp_path, "a", {})
    work.heed(starter.ENDED, 0)
    assert (work.state, work.moves, work.done.is_set()) == ("failed", False, True)
    assert str(error.args[0]) in work.why


@pytest.mark.parametrize("error", [TypeError("no list"), IndexError("none"), OSError(28, "No space left on device")])
def test_a_command_that_cannot_begin_ends_the_work_as_failed(work: Work, error: Exception) -> None:
    def arguments(answers: Answers) -> list[str]:
        raise error

    work.begin(Order("A", (Command("a", arguments, moves=True),)), "me")
    assert (work.state, work.moves) == ("failed", False)
    assert "a cannot begin" in work.why
    assert str(error.args[-1]) in work.why


def test_an_answer_of_another_day_is_none(work: Work, tmp_path: Path) -> None:
    answer(tmp_path, "a", {"old": True})
    work.begin(Order("A", (command("a", "run"),)), "me")
    work.heed(starter.ENDED, 0)
    assert work.state == "failed"


def test_a_stop_lets_go_and_is_no_failure(work: Work, line: Line) -> None:
    work.begin(Order("A", (command("a", "run", moves=True), command("b", "identify"))), "me")
    work.let_go("stop button")
    assert line.sent[-1] == (starter.LET_GO, None)
    work.heed(starter.SAID, "isocenter: asked to stop; the motors were stopped", True)
    work.heed(starter.ENDED, 1)
    assert work.state == "stopped"
    assert "stop button" in work.why
    assert "the motors were stopped" in work.why


def test_only_one_order_at_a_time(work: Work) -> None:
    work.begin(Order("Static", (command("a", "run"),)), "me")
    with pytest.raises(UnusableInputError, match="Static is running"):
        work.begin(Order("Scan", (command("b", "run"),)), "you")


def test_a_client_that_answers_is_here_and_one_that_does_not_is_not() -> None:
    now = 100.0
    attention = Attention(lambda: now)
    mine, yours = attention.welcome(""), attention.welcome("")
    assert mine != yours
    now += 0.9 * SILENT_S
    attention.heard(yours)
    now += 0.2 * SILENT_S
    assert not attention.is_here(mine)
    assert attention.is_here(yours)
    assert not attention.is_here("somebody")
    attention.leave(mine)
    assert attention.welcome(mine) == mine  # a page that is loaded anew goes on as the same
    assert attention.is_here(mine)
    assert attention.welcome("made up") != "made up"


def test_a_page_that_is_loaded_anew_was_never_away() -> None:
    now = 100.0
    attention = Attention(lambda: now)
    assert not attention.somebody_looks
    mine = attention.welcome("")
    now += 2.0 * AWAY_S
    assert attention.somebody_looks
    attention.leave(mine)
    now += 0.9 * AWAY_S
    assert attention.somebody_looks
    now += 0.2 * AWAY_S
    assert not attention.somebody_looks


def test_a_tab_that_was_duplicated_is_another_client() -> None:
    now = 100.0
    attention = Attention(lambda: now)
    first = attention.welcome("")
    duplicate = attention.welcome(first)
    assert duplicate != first
    attention.leave(first)
    now += 1.1 * SILENT_S
    attention.heard(duplicate)
    assert attention.is_here(duplicate)
    assert not attention.is_here(first)


def test_a_release_is_waited_for_while_a_drive_holds_and_no_longer(work: Work) -> None:
    said: list[str] = []
    operator = Operator(said.append)
    operator.say("roll held by its drive: its brake reports open")
    operator.say("roll at rest: brake proven, voltage off")
    begins, ends = said
    work.begin(Order("A", (command("a", "run", moves=True),)), "me")
    seen = [work.holds]
    for text in ("carm: booting", begins, "another line", ends):
        work.heed(starter.SAID, text, True)
        seen.append(work.holds)
    assert seen == [False, False, True, True, False]
    work.heed(starter.SAID, begins, True)
    work.heed(starter.ENDED, 1)
    assert not work.holds
    work.begin(Order("A", (command("a", "run", moves=True),)), "me")
    assert not work.holds


@pytest.mark.parametrize("kind", ["static", "jog", "scan", "multisine"])
def test_every_form_as_it_stands_is_an_experiment_with_a_plan(facts: Facts, kind: str) -> None:
    short = {"seconds": 1.0, "period": 2.0, "periods": 1, "realisations": 1, "jog": 0.2, "low": 1.0}
    found = preview("carm", forms_of(facts)[kind].text(facts, short))
    assert "refused" not in found, found
    assert all(each["rows"] > 0 for each in found["recordings"])
    assert "predicted peak command: propeller" in " ".join(found["recordings"][0]["notes"])


def test_a_form_means_what_it_says(facts: Facts, carm: Machine) -> None:
    text = forms_of(facts)["scan"].text(facts, {"axis": "roll", "from": -30, "to": 45.5, "speed": 20})
    experiment = experiment_from_text(text, carm)
    assert isinstance(experiment, Scan)
    assert (experiment.start, experiment.stop, experiment.speed) == pytest.approx((math.radians(-30), math.radians(45.5), math.radians(20)))


def test_an_experiment_that_breaks_a_limit_is_refused_in_its_plan(facts: Facts) -> None:
    found = preview("carm", forms_of(facts)["scan"].text(facts, {"axis": "roll", "from": -30, "to": 200}))
    assert "roll" in found["refused"]


@pytest.mark.parametrize(
    ("kind", "values", "wrong"),
    [
        ("static", {"seconds": "ten"}, "Duration"),
        ("static", {"seconds": math.nan}, "Duration"),
        ("static", {"pose_roll": 1e6}, "roll"),
        ("jog", {"periods": 1.5}, "whole number"),
        ("scan", {"axis": 'roll"\nx = 1'}, "propeller, roll"),
    ],
)
def test_a_field_that_cannot_be_used_is_named(facts: Facts, kind: str, values: dict[str, Any], wrong: str) -> None:
    with pytest.raises(UnusableInputError, match=wrong):
        forms_of(facts)[kind].text(facts, values)


def test_forms_of_a_machine_in_millimetres_are_in_millimetres(carm: Machine) -> None:
    machine = next(m for m in map(load_machine, ("turntable", "carm")) if m.bus is not None)
    facts = facts_of(machine.name, machine, "udp:")
    assert {field.unit for field in forms_of(facts)["static"].fields} == {"s", facts.axes[0].edge_unit}
    assert tomllib.loads(forms_of(facts)["static"].text(facts, {}))["duration_s"] == 10.0


def test_steps_wait_for_what_they_build_on(facts: Facts, tmp_path: Path) -> None:
    assert list(steps_of(facts, tmp_path)) == ["check", "scan", "home", "static", "identify", "shape", "observe"]
    assert missing_before("home", {}, {}) == ""
    assert "first home" in missing_before("static", {"home": False}, {})
    assert "identify and static" in missing_before("observe", {"home": True}, {})
    assert missing_before("observe", {"identify": True, "static": True}, {}) == ""


def test_a_shaper_is_designed_from_a_response_that_was_identified_here(facts: Facts, tmp_path: Path) -> None:
    source = next(field for field in steps_of(facts, tmp_path)["shape"].fields if field.name == "source")
    from_file, from_response = source.choices
    assert missing_before("shape", {}, {"source": from_file}) == ""
    assert missing_before("shape", {}, {}) == ""
    assert "first identify" in missing_before("shape", {"identify": False}, {"source": from_response})
    assert missing_before("shape", {"identify": True}, {"source": from_response}) == ""


def test_steps_say_what_moves_and_by_how_much(facts: Facts, tmp_path: Path) -> None:
    says = " ".join(steps_of(facts, tmp_path)["home"].does)
    assert "propeller" in says
    assert "0.3 A" in says


@pytest.mark.parametrize(("nodes", "passed", "why"), [([1, 2], True, "all 2"), ([1], False, "2 \\(roll\\)"), ([1, 2, 9], False, "node 9")])
def test_the_bus_must_have_the_nodes_of_the_file_and_no_others(nodes: list[int], passed: bool, why: str) -> None:
    found = scan({"scan": {"nodes": [{"node_id": each} for each in nodes]}}, {1: "propeller", 2: "roll"})
    assert found[0] is passed
    assert re.search(why, found[1])


def test_no_two_runs_of_an_emulated_machine_have_the_same_noise_and_a_real_one_is_given_none(carm: Machine, tmp_path: Path) -> None:
    """Recordings with the same rows are refused as repeats."""
    emulated, real = (facts_of("carm", carm, bus) for bus in ("lockstep:", "udp:"))
    seeds = []
    for name in ("first", "second"):
        arguments = run_command(emulated, tmp_path, name, "").arguments({})
        seeds.append(arguments[arguments.index("--seed") + 1])
        (tmp_path / f"{name}.mf4").touch()
    assert len(set(seeds)) == 2
    assert "--seed" not in run_command(real, tmp_path, "third", "").arguments({})
