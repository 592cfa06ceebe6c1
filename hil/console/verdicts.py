"""Why a step has passed or failed, from the answers of its commands. A command that failed has said why itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil.console.commands import Answers
from hil.verbs.observe import NIS_BAND


def check(answers: Answers) -> tuple[bool, str]:
    """Ask that all findings hold."""
    findings = answers["check"]["findings"]
    failing = [each["text"] for each in findings if not each["ok"]]
    return not failing, f"{len(findings)} of {len(findings)} checks hold" if not failing else f"{len(failing)} fail: {failing[0]}"


def scan(answers: Answers, expected: Mapping[int, str]) -> tuple[bool, str]:
    """Ask that the nodes of the file answer, and no others."""
    if "scan" not in answers:
        return True, "nothing to look at: the machine is emulated in the run's own process"
    found = {int(node["node_id"]) for node in answers["scan"]["nodes"]}
    absent = [f"{number} ({name})" for number, name in expected.items() if number not in found]
    foreign = sorted(found - set(expected))
    if absent:
        return False, f"node {', '.join(absent)} does not answer; is it on, and does the file have its number?"
    if foreign:
        return False, f"node {', '.join(map(str, foreign))} answers and is not in the file; two masters, or another machine's bus?"
    return True, f"all {len(expected)} nodes of the file answer, and no others"


def home(answers: Answers) -> tuple[bool, str]:
    """Nothing was found of the sensors; directions, homing and encoders were checked by the command."""
    judged = answers["home"]["judged"]
    if judged:
        return False, f"sensors not to be believed: {'; '.join(map(str, judged))}"
    return True, f"{len(answers['home']['checks'])} findings: directions are right, axes are homed, encoders agree"


def recorded(answer: Mapping[str, Any]) -> tuple[bool, str]:
    """Every recording is there, and its sensors are to be believed."""
    judged = [str(line) for each in answer["recordings"] for line in each["judged"]]
    if judged:
        return False, f"sensors not to be believed: {'; '.join(judged)}"
    rows = sum(int(each["timing"]["ticks"]) for each in answer["recordings"])
    missed = sum(int(each["timing"]["missed"]) for each in answer["recordings"])
    count = len(answer["recordings"])
    return True, f"{rows} rows in {count} recording{'s' if count > 1 else ''}, {missed} ticks missed"


def static(answers: Answers) -> tuple[bool, str]:
    """Judge the recording at rest."""
    passed, why = recorded(answers["still"])
    notes = [str(line) for each in answers["still"]["recordings"] for line in each["notes"] if "does not stand" in str(line)]
    return (False, notes[0]) if passed and notes else (passed, why)


def identify(answers: Answers) -> tuple[bool, str]:
    """Judge the recordings, and tell of the frequency response from them."""
    passed, why = recorded(answers["multisine"])
    response = answers["identify"]
    lines = response["frequencies_Hz"]
    band = f"{len(lines)} lines from {lines[0]:.3g} to {lines[-1]:.3g} Hz"
    size = f"{len(response['inputs'])} inputs, {len(response['outputs'])} outputs"
    return passed, f"{why}; {band}, {size}" if passed else why


def shape(answers: Answers) -> tuple[bool, str]:
    """Tell the chosen design."""
    return True, str(answers["shape"]["verdict"])


def observe(answers: Answers) -> tuple[bool, str]:
    """Ask that the observer's innovations fit."""
    passed, why = recorded(answers["observed"])
    if not passed:
        return passed, why
    nis = float(answers["observe"]["mean_nis"])
    fits = NIS_BAND[0] <= nis <= NIS_BAND[1]
    words = f"squared innovations are {nis:.2f} times what the observer expects"
    return fits, f"{words}, 1 fits" if fits else f"{words}; {NIS_BAND[0]:g} to {NIS_BAND[1]:g} would do: record at rest and excite again"
