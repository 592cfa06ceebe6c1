"""Ten questions that people ask of their axes, on an emulated one whose truth is known: what is recorded, and what a diagnosis answers.

    python benchmarks/axis_questions.py --work WORK

Each question is of the kind of a public report. Answers go to results/axis_questions.json, with the commands that led there, and a figure
each to WORK. Answers that are there are kept; --only makes one anew.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

from hil.machine import load_machine
from hil.recording import Recording, read_recording

mpl.use("agg")
RESULTS = Path(__file__).parent / "results" / "axis_questions.json"
COMMAND = (sys.executable, "-c", "import sys; from hil.cli import main; sys.exit(main())")
BLUE, ORANGE = "#0072B2", "#D55E00"
EVEN, SLOW, FAST = ("--amplitude 20 --period 6", 2), ("--amplitude 5 --period 20", 1), ("--amplitude 8 --period 3", 4)
"""Options of a jog, and its periods: the table's largest acceleration, and speeds at which it sticks, are in the last two."""

Curve = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Question:
    """One question.

    Attributes
    ----------
    asks, source : str
        What somebody asks, in our words; the public report of which it is a kind.
    truth : str
        What the emulated table has beside its machine file: the text of an effects file.
    motion : (str, int)
        Of the training recordings.
    curve : callable
        What is plotted of a recording.
    labels : (str, str)
        Of both axes of the plot.
    shows : str
        What to look for in it.
    machine : str
        Shipped machine, or `geared.toml`.
    """

    asks: str
    source: str
    truth: str
    motion: tuple[str, int]
    curve: Callable[[Recording], Curve]
    labels: tuple[str, str]
    shows: str
    machine: str = "turntable"


def effect(name: str, at: str = "turn", **values: float) -> str:
    """Return the text of an effects file with one effect."""
    return "\n".join(["[[effect]]", f'name = "{name}"', f'at = "{at}"', *(f"{key} = {value}" for key, value in values.items())]) + "\n"


def sides(recording: Recording) -> Curve:
    """Return position [deg], and the link's less the motor's [mrad]."""
    motor, link = recording["position_turn"], recording["link_position_turn"]
    return np.degrees(motor), 1e3 * (link - motor)


def effort_over_position(recording: Recording) -> Curve:
    """Return position [deg] and current [A]."""
    return np.degrees(recording["position_turn"]), recording["current_turn"]


def effort_over_speed(recording: Recording) -> Curve:
    """Return speed [deg/s] and current [A]."""
    return np.degrees(np.gradient(recording["link_position_turn"], recording["time"])), recording["current_turn"]


def effort_over_time(recording: Recording) -> Curve:
    """Return time [s] and current [A]."""
    return recording["time"], recording["current_turn"]


def error_over_time(recording: Recording) -> Curve:
    """Return time [s] and what the reference is ahead [mrad]."""
    return recording["time"], 1e3 * (recording["reference_turn"] - recording["position_turn"])


SIDES = ("Position [°]", "Link less motor side [mrad]")
BY_POSITION, BY_SPEED, BY_TIME = ("Position [°]", "Current [A]"), ("Speed [°/s]", "Current [A]"), ("Time [s]", "Current [A]")
ERROR = ("Time [s]", "Reference less position [mrad]")
QUESTIONS = {
    "play": Question(
        "My geared motor has play. Or is it friction?",
        "https://github.com/misan/dcservo/issues/57",
        effect("backlash", b_rad=0.001, flank_rad=0.00001),
        FAST,
        sides,
        SIDES,
        "Two sides, a fixed distance apart, crossed where the table is driven the other way",
        "geared.toml",
    ),
    "jumps": Question(
        "Slow moves go in steps, fast ones do not.",
        "https://github.com/almond-bot/axol/pull/317",
        effect("coulomb_friction", Fc_Nm=3.0) + "\n" + effect("stribeck_friction", Fs_minus_Fc_Nm=2.5, vs_rad_s=0.01, delta=2.0),
        SLOW,
        error_over_time,
        ERROR,
        "The error grows while the axis sticks, and falls at once when it breaks away",
    ),
    "ripple": Question(
        "At low speed the motor jerks at even distances.",
        "https://github.com/makerbase-motor/MKS-SERVO42D-57D/issues/16",
        effect("cogging", Np_cycles_turn=7.0, A1_Nm=1.5, phi1_rad=0.4, A2_Nm=0.0, phi2_rad=0.0),
        SLOW,
        effort_over_position,
        BY_POSITION,
        "Waves over position, alike both ways",
    ),
    "late": Question(
        "The real actuator is not where the simulated one is at the same time: which lag is it?",
        "https://github.com/google-deepmind/mujoco/issues/908",
        effect("delay", Td_s=0.012),
        FAST,
        error_over_time,
        ERROR,
        "The same shape, later and larger: the loop loses phase",
    ),
    "angle": Question(
        "The joint overshoots every angle by the same share, though its encoder says that it is there.",
        "https://github.com/elephantrobotics/pymycobot/issues/252",
        effect("gear_ratio", beta=0.03),
        EVEN,
        sides,
        SIDES,
        "A straight line over position: a ratio",
    ),
    "disc": Question(
        "The magnet of the encoder is not centred. How much does that cost?",
        "https://github.com/motionlayer/Tinymovr/issues/109",
        effect("encoder_eccentricity", "link_position_turn", a_rad=0.002, phi_rad=0.7, b_rad=0.0, Nl_cycles_turn=64.0),
        EVEN,
        sides,
        SIDES,
        "A part of one wave a turn, alike both ways",
    ),
    "rotor": Question(
        "It accelerates more slowly than in simulation. Is the rotor's inertia missing?",
        "https://github.com/RobotLocomotion/drake/issues/13657",
        effect("added_inertia", J_kg_m2=2.0),
        FAST,
        effort_over_time,
        BY_TIME,
        "More current where it speeds up or slows down, none more where the speed is constant",
    ),
    "drift": Question(
        "With its weight compensated, the joint drifts to one side.",
        "https://github.com/lbr-stack/lbr_fri_ros2_stack/issues/232",
        effect("constant_load", tau0_Nm=1.5),
        EVEN,
        effort_over_speed,
        BY_SPEED,
        "The same distance up at every speed, both ways: a load",
    ),
    "limit": Question(
        "The torque does not follow its command when it moves fast.",
        "https://github.com/bgkatz/motorcontrol/issues/9",
        effect("current_saturation", imax_A=2.2, droop_A_s_rad=0.5),
        FAST,
        effort_over_time,
        BY_TIME,
        "The current is cut at its peaks",
    ),
    "friction": Question(
        "It takes a lot of effort to turn the joint at all. How much of that is dry friction?",
        "https://github.com/roboticslab-uc3m/yarp-devices/issues/261",
        effect("coulomb_friction", Fc_Nm=4.0),
        EVEN,
        effort_over_speed,
        BY_SPEED,
        "A step at standstill, one way up, the other down: dry friction",
    ),
}
GEAR = """
[[body]]
name = "wheel"
parent = "world"
mass_kg = 1.0
inertia_kg_m2 = [0.01, 0.01, 0.01, 0.0, 0.0, 0.0]
[body.joint]
name = "turn"
type = "revolute"
axis = [0.0, 0.0, 1.0]
damping_Nm_s_rad = 23.0
brake_effort_Nm = 100.0
brake_delay_s = 0.04

"""
HELD_OUT = "--amplitude 12 --period 5 --periods 2"


def geared() -> str:
    """Return the turntable's file with the gear of its drive, which gives way, between motor and table."""
    text = load_machine("turntable").text.replace('name = "turntable"', 'name = "geared"', 1)
    begin, end = text.index("[[body]]"), text.index("[drives.turn]")
    table = text[begin:end].replace('parent = "world"', 'parent = "wheel"').replace('name = "turn"', 'name = "gear"')
    table = "".join(line for line in table.splitlines(keepends=True) if not line.startswith(("brake_", "damping_")))
    table = table.rstrip() + "\nstiffness_Nm_rad = 2.0e5\ndamping_Nm_s_rad = 60.0\n\n"
    link = text[end:].replace('joints = ["turn"]\nkind = "absolute"', 'joints = ["turn", "gear"]\nkind = "absolute"')
    return text[:begin] + GEAR.lstrip() + table + link


def commands(question: Question) -> list[str]:
    """Return what is typed, line by line, in a folder with `truth.toml` and `geared.toml`."""
    motion, periods = question.motion
    run = f"isocenter run jog -m {question.machine} -b lockstep: --effects truth.toml"
    repeats = [f"{run} {motion} --periods {periods} --seed {seed} -o r{seed}.mf4" for seed in (1, 2, 3)]
    return [
        *repeats,
        f"{run} {HELD_OUT} --seed 11 -o held-out.mf4",
        f"isocenter simulate {question.machine} r1.mf4 -o plain.mf4",
        f"isocenter diagnose {question.machine} r1.mf4 r2.mf4 r3.mf4 --held-out held-out.mf4 -o found",
    ]


def typed(line: str, folder: Path) -> str:
    """Run a command in a folder; return what it prints."""
    words = shlex.split(line)[1:]
    done = subprocess.run([*COMMAND, *words], cwd=folder, capture_output=True, text=True, check=False, env=os.environ | {"NO_COLOR": "1"})
    if done.returncode not in (0, 1) or "Traceback" in done.stderr:
        raise SystemExit(f"{line}\n{done.stdout}{done.stderr}")
    return done.stdout


def figure(question: Question, folder: Path, path: Path) -> None:
    """Draw a recording beside its simulation by the machine file alone."""
    fig, axes = plt.subplots(figsize=(5.6, 2.8), layout="constrained")
    for name, colour, style, label in (("r1", BLUE, "-", "recorded"), ("plain", ORANGE, "--", "simulated by its file")):
        axes.plot(*question.curve(read_recording(folder / f"{name}.mf4")), color=colour, ls=style, lw=1.0, label=label)
    axes.set(xlabel=question.labels[0], ylabel=question.labels[1])
    axes.grid(alpha=0.25)
    fig.legend(loc="outside upper center", ncols=2, frameon=False)
    fig.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(fig)


def answered(question: Question, folder: Path) -> dict[str, Any]:
    """Record, diagnose and draw one question."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "truth.toml").write_text(question.truth)
    (folder / "geared.toml").write_text(geared())
    for line in commands(question):
        printed = typed(line, folder)
    figure(question, folder, folder / "symptom.png")
    said = printed.split("\nE, misfit")[0].strip().splitlines()
    return {
        "asks": question.asks,
        "source": question.source,
        "truth": question.truth,
        "shows": question.shows,
        "commands": commands(question),
        "said": said,
        "named": names_truth(question, folder / "found" / "diagnosis.json"),
    }


def names_truth(question: Question, answer: Path) -> bool:
    """Return whether an answer has every effect of the truth, at its place, among what it found."""
    found = {(each.get("effect"), each.get("at")) for each in json.loads(answer.read_text(encoding="utf-8"))["findings"]}
    return {(each["name"], each["at"]) for each in tomllib.loads(question.truth)["effect"]} <= found


def main() -> None:
    """Answer what is not answered yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True, help="folder for recordings and answers")
    parser.add_argument("--only", choices=QUESTIONS, help="make this answer anew")
    arguments = parser.parse_args()
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for name, question in QUESTIONS.items():
        if name == arguments.only or (arguments.only is None and name not in found):
            found[name] = answered(question, arguments.work / name)
            found = {each: found[each] for each in QUESTIONS if each in found}
            RESULTS.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
            print(name, *found[name]["said"], sep="\n  ", flush=True)
    print(f"the truth is named, where it is: {sum(each['named'] for each in found.values())} of {len(found)}")


if __name__ == "__main__":
    main()
