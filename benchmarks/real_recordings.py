"""Diagnosis of recordings that other people measured: `python benchmarks/real_recordings.py [SET...] [--out DIR] [--json FILE]`.

For every set: verdict, what is named and how sure, held-out free-run error per channel before and after, in NRMSE and in the channel's own
unit, and the rms. Writes benchmarks/results/real_recordings.json unless told otherwise.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from real_data import DATA, REAL_SETS, RealSet

from hil.diagnosis.diagnose import Outcome, diagnose
from hil.diagnosis.files import write_diagnosis
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN
from hil.simulation import Simulator, inputs_of
from hil.terminal.output import plain

RESULTS = Path(__file__).resolve().parent / "results" / "real_recordings.json"
STAGES = ("nominal", "retuned", "extended")


def errors(outcome: Outcome, which: str) -> dict[str, dict[str, float]]:
    """Rms per channel and stage, in the channel's unit, over all groups."""
    found = outcome.train if which == TRAIN else outcome.held_out
    assert found is not None
    table = {}
    for c, name in enumerate(found.channels):
        rms = {}
        for stage in STAGES:
            residual = np.concatenate(
                [(group.mean - rows)[:, c] for group, rows in zip(found.groups, outcome.stages[which][stage], strict=True)]
            )
            rms[stage] = float(np.sqrt(np.mean(residual**2)))
        table[f"{name} [{found.units[c]}]"] = rms
    return table


def open_loop_mm(data: RealSet, outcome: Outcome) -> dict[str, dict[str, float]]:
    """Position rms [mm] of an axis driven by its recorded command alone, as published for `emps`: nominal and with the effects."""
    machine = replace(data.machine, controllers=())
    simulator = Simulator(machine)
    table = {}
    for which, recordings in (("train", data.train), ("held_out", data.held_out)):
        ((_, recording),) = recordings.items()
        inputs = inputs_of(machine, recording)
        rms = {}
        for stage, values, effects in (("nominal", None, ()), ("extended", outcome.values, outcome.effects)):
            position = simulator.run(inputs, values, effects).position[:, 0]
            rms[stage] = float(1e3 * np.sqrt(np.mean((position - recording[f"position_{machine.axes[0]}"]) ** 2)))
        table[which] = rms
    return table


def entry(data: RealSet, outcome: Outcome) -> dict[str, Any]:
    """What the results hold of one set."""
    document = outcome.diagnosis.document()
    found = {key: document[key] for key in ("verdict", "reason", "findings", "hypotheses", "retuned", "noise", "unexplained_share")}
    return {
        **found,
        "channels_nrmse_held_out": document["fit"]["channels"],
        "removed_share": document["fit"]["removed_share"],
        "removed_share_from_nominal": document["fit"]["removed_share_from_nominal"],
        "rms_train": errors(outcome, TRAIN),
        "rms_held_out": errors(outcome, HELD_OUT),
        "suspicions": list(outcome.diagnosis.suspicions),
        "train": list(data.train),
        "held_out": list(data.held_out),
        "seconds": document["seconds"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="*", choices=[*REAL_SETS, []], help="which sets; all by default")
    parser.add_argument("--out", type=Path, help="folder for the reports, one folder a set")
    parser.add_argument("--json", type=Path, default=RESULTS, help="results file; sets that are not run keep theirs")
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    if not DATA.is_dir():
        raise SystemExit(f"{DATA} is not here: these recordings are not part of the project")
    results = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
    for name in arguments.sets or REAL_SETS:
        data = REAL_SETS[name]()
        outcome = diagnose(data.machine, data.train, data.held_out, jobs=arguments.jobs)
        results[name] = entry(data, outcome)
        if name == "emps":
            results[name]["open_loop_position_rms_mm"] = open_loop_mm(data, outcome)
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(plain(results), indent=1) + "\n")
        print(f"{name}: {outcome.diagnosis.verdict}: {outcome.diagnosis.reason} ({outcome.diagnosis.seconds:.0f} s)")
        for finding in outcome.diagnosis.findings:
            numbers = ", ".join(f"{key} = {e.value:.4g} {e.unit}" for key, e in finding.parameters.items())
            print(f"  {finding.effect}, confidence {finding.confidence:.2f}: {numbers}")
        if arguments.out is not None:
            write_diagnosis(outcome, data.machine, arguments.out / name)
        for channel, rms in errors(outcome, HELD_OUT).items():
            print(f"  held-out rms of {channel}: " + ", ".join(f"{stage} {value:.4g}" for stage, value in rms.items()))


if __name__ == "__main__":
    main()
