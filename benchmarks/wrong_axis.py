"""Answer the questions of docs/examples/wrong_axis by the product's own commands, and draw their symptoms.

Every case is recorded as the tutorial on missing physics records: three repeats of one motion, and another that is held out. What each
command prints is kept as it is.

    python benchmarks/wrong_axis.py
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import shlex
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("svg")
import matplotlib.pyplot as plt

from hil.cli import main as isocenter
from hil.recording import read_recording

ROOT = Path(__file__).resolve().parents[1]
CASES = ROOT / "docs" / "examples" / "wrong_axis" / "cases.toml"
RESULTS = ROOT / "benchmarks" / "results" / "wrong_axis.json"
FIGURE = ROOT / "docs" / "figures" / "wrong_axis.svg"
MACHINE = "turntable"
REPEATS = 3
COLUMNS = 2
SAID_LINES = 8  # of an answer: verdict, effects, misfits


def commands(hidden: bool) -> list[str]:
    """Return the commands that record a case, in an empty folder."""
    effects = " --effects hidden.toml" if hidden else ""
    run = f"run jog -m {MACHINE} -b lockstep:{effects}"
    repeats = [f"{run} --amplitude 3.4 --period 10 --periods 1 --seed {n} -o r{n}.mf4" for n in range(1, REPEATS + 1)]
    return [*repeats, f"{run} --amplitude 2.6 --period 8 --periods 1 --seed 11 -o held-out.mf4"]


DIAGNOSE = f"diagnose {MACHINE} r1.mf4 r2.mf4 r3.mf4 --held-out held-out.mf4 -o found"


def said(command: str) -> tuple[int, str]:
    """Return exit status and output of a command."""
    out = io.StringIO()
    status = 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            isocenter(shlex.split(command))
        except SystemExit as ended:
            status = int(ended.code or 0)
    return status, out.getvalue()


def effects_text(hidden: dict[str, Any]) -> str:
    """Return the effects file of a case."""
    return "\n".join(["[[effect]]", *(f"{key} = {json.dumps(value)}" for key, value in hidden.items())]) + "\n"


def answered(case: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Record a case and ask what is wrong with it."""
    (folder / "hidden.toml").write_text(effects_text(case["hidden"]))
    for command in commands(hidden=True):
        status, text = said(command)
        if status:
            return {"name": case["name"], "command": command, "status": status, "said": text, "named": [], "verdict": ""}
    status, text = said(DIAGNOSE)
    found = json.loads((folder / "found" / "diagnosis.json").read_text()) if (folder / "found" / "diagnosis.json").exists() else {}
    lines = [line.rstrip() for line in text.splitlines() if line.strip() and not line.startswith("found: ")]
    return {
        "name": case["name"],
        "command": f"isocenter {DIAGNOSE}",
        "status": status,
        "said": "\n".join(lines[:SAID_LINES]),
        "named": sorted({effect["name"] for effect in found.get("effects", [])}),
        "verdict": found.get("verdict", ""),
    }


def traces(folder: Path, shows: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the angle [deg] and what the plot draws of the first recording."""
    recording = read_recording(folder / "r1.mf4")
    angle = np.degrees(recording["position_turn"])
    if shows == "command":
        return angle, np.asarray(recording["command_turn"])
    return angle, 1e3 * (recording["link_position_turn"] - recording["position_turn"])


def draw(drawn: list[tuple[dict[str, Any], tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]]) -> None:
    """Draw one panel a case: the machine of the case over the sound one."""
    rows = -(-len(drawn) // COLUMNS)
    figure, panels = plt.subplots(rows, COLUMNS, figsize=(7.5, 2.3 * rows), layout="constrained")
    for panel, (case, has, sound) in zip(panels.flat, drawn, strict=True):
        panel.plot(*(each[::8] for each in sound), color="0.6", lw=1.0, label="without")
        panel.plot(*(each[::8] for each in has), color="#0072b2", lw=1.0, label="with it")
        panel.set_title(case["name"].replace("_", " "), fontsize=9)
        panel.set_ylabel("command [A]" if case["shows"] == "command" else "link - motor [mrad]", fontsize=8)
        panel.set_xlabel("angle [deg]", fontsize=8)
        panel.tick_params(labelsize=7)
    panels.flat[0].legend(fontsize=7)
    plt.rcParams["svg.hashsalt"] = "wrong_axis"
    figure.savefig(FIGURE, metadata={"Date": None})


def main() -> None:
    """Answer what the results lack, and draw all."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    cases = tomllib.loads(CASES.read_text(encoding="utf-8"))["case"]
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"cases": []}
    kept = {row["name"]: row for row in results["cases"]}
    drawn, home = [], Path.cwd()
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        said(commands(hidden=False)[0])
        sound = {shows: traces(Path(name), shows) for shows in ("command", "difference")}
        for case in cases:
            folder = Path(name) / case["name"]
            folder.mkdir()
            os.chdir(folder)
            if case["name"] in kept:
                (folder / "hidden.toml").write_text(effects_text(case["hidden"]))
                said(commands(hidden=True)[0])
            else:
                kept[case["name"]] = answered(case, folder)
                rows = [kept[each["name"]] for each in cases if each["name"] in kept]
                RESULTS.write_text(json.dumps({"cases": rows}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
                print(case["name"], kept[case["name"]]["said"], flush=True)
            if (folder / "r1.mf4").exists():
                drawn.append((case, traces(folder, case["shows"]), sound[case["shows"]]))
        os.chdir(home)
    draw(drawn)


if __name__ == "__main__":
    main()
