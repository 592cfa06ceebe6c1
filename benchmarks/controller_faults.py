"""Whether the audit finds controllers that are not the machine file's: `python benchmarks/controller_faults.py [--json FILE]`.

Twenty faults drawn by seed (gain, delay, limit, sign, rate, another law) and three hundred sound controllers, in a loop that this script
closes by itself, whose law is SciPy's: a mass with a damper, a disturbance and a quantised encoder. Writes
benchmarks/results/controller_faults.json unless told otherwise.
"""

from __future__ import annotations

import argparse
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy.signal

from hil.diagnosis.audit.controller import AxisAudit, audit_controllers
from hil.machine import Machine, load_machine
from hil.recording import Channel, Recording, recording_metadata
from virtual_bus.plant.compiled import compile_plant

RESULTS = Path(__file__).resolve().parent / "results" / "controller_faults.json"
SEED = 53
SOUND, FAULTY = 300, 20
KINDS = ("gain", "delay", "limit", "sign", "rate", "law")
ROWS = 1500
ROWS_BEFORE_IT_RUNS_AWAY = 150
"""Of a loop with a wrong sign."""


def closed_loop(machine: Machine, rng: np.random.Generator, fault: dict[str, float]) -> Recording:
    """Record one axis of a machine in its loop, with this fault."""
    controller = machine.controllers[0]
    axis, period = controller.axis, 1.0 / machine.sample_rate_Hz
    rows = ROWS_BEFORE_IT_RUNS_AWAY if fault.get("sign") else ROWS
    time = np.arange(rows) * period
    swing = rng.uniform(0.02, 0.2)
    reference = swing * np.sin(2.0 * np.pi * rng.uniform(0.2, 0.6) * time) ** 2
    excitation = 0.05 * controller.limit * scipy.signal.lfilter([0.1], [1.0, -0.9], rng.normal(size=rows))
    sections = controller.position_sections.copy()
    if "law" in fault:
        sections[-1, :3] *= np.array([1.0, 1.0 - fault["law"], 1.0 + fault["law"]])
    asked_sections = controller.reference_sections
    drive = machine.plant.drives[0]
    inertia = _inertia(machine.name)
    gain_on_joint = drive.constant * drive.ratio
    count = rng.choice([1e-6, 1e-5])
    states = np.zeros((len(sections), 2))
    states[0, 0] = rng.normal() * 0.005 * controller.limit  # the integrator's start
    asked_states = None if asked_sections is None else np.zeros((len(asked_sections), 2))
    late = [0.0] * (int(fault.get("delay", 0)) + 1)
    position, speed, acting, held = 0.0, 0.0, 0.0, 0.0
    positions, commands = np.zeros(rows), np.zeros(rows)
    for k in range(rows):
        positions[k] = count * np.floor(position / count + 0.5)
        error = reference[k] - positions[k]
        if asked_sections is None:
            (law,), states = scipy.signal.sosfilt(sections, [error], zi=states)
        else:
            (asked,), asked_states = scipy.signal.sosfilt(asked_sections, [reference[k]], zi=asked_states)
            (measured,), states = scipy.signal.sosfilt(sections, [positions[k]], zi=states)
            law = asked - measured
        late.append(law * fault.get("gain", 1.0) * (-1.0 if fault.get("sign") else 1.0))
        limit = fault.get("limit", 1.0) * controller.limit
        held = held if "rate" in fault and k % int(fault["rate"]) else late[-1 - int(fault.get("delay", 0))]
        commands[k] = np.clip(held + excitation[k], -limit, limit)
        force = gain_on_joint * acting - 2.0 * inertia * speed + 0.02 * gain_on_joint * controller.limit * rng.normal()
        speed += period * force / inertia
        position += period * speed
        acting = commands[k]
    unit, effort = machine.units[0].position, machine.units[0].effort
    channels = {
        "time": Channel("s", time),
        f"reference_{axis}": Channel(unit, reference),
        f"excitation_{axis}": Channel(effort, excitation),
        f"command_{axis}": Channel(effort, commands),
        f"position_{axis}": Channel(unit, positions),
    }
    return Recording(channels, recording_metadata(machine))


@cache
def _inertia(name: str) -> float:
    """Return what moves with the first axis, so that the loop is as stable as it was designed to be."""
    machine = load_machine(name)
    plant = compile_plant(machine.plant)
    q = np.zeros(plant.joints)
    joint = plant.joint_of_axis()[machine.axes[0]]
    return float(plant.inertia_and_bias(plant.model(), q, q)[0][joint, joint])


def drawn(rng: np.random.Generator, kind: str, machine: Machine) -> dict[str, float]:
    """Draw the fault of a kind."""
    if kind == "gain":
        return {"gain": float(rng.choice([rng.uniform(0.5, 0.98), rng.uniform(1.02, 1.5)]))}
    if kind == "delay":
        return {"delay": float(rng.integers(1, 4))}
    if kind == "limit":
        peak = float(np.abs(closed_loop(machine, rng, {})[f"command_{machine.axes[0]}"]).max())
        return {"limit": float(rng.uniform(0.4, 0.7)) * peak / machine.controllers[0].limit}
    if kind == "sign":
        return {"sign": 1.0}
    if kind == "rate":
        return {"rate": float(rng.integers(2, 5))}
    return {"law": float(rng.uniform(0.01, 0.05))}


def is_found(audit: AxisAudit, fault: dict[str, float], machine: Machine) -> bool:
    """Return whether the audit says what is wrong, numbers to half a per cent."""
    if audit.status != "differs":
        return False
    period = 1.0 / machine.sample_rate_Hz
    if "gain" in fault:
        return audit.gain.value is not None and abs(audit.gain.value / fault["gain"] - 1.0) < 0.005
    if "delay" in fault:
        return audit.delay_s.value is not None and abs(audit.delay_s.value - fault["delay"] * period) < 0.005 * period
    if "limit" in fault:
        right = fault["limit"] * machine.controllers[0].limit
        return audit.saturation.value is not None and abs(audit.saturation.value / right - 1.0) < 0.005
    if "sign" in fault:
        return audit.gain.value is not None and abs(audit.gain.value + 1.0) < 0.005
    if "rate" in fault:
        return audit.rate_Hz.value is not None and abs(audit.rate_Hz.value * fault["rate"] * period - 1.0) < 0.005
    return True


def measured(faulty: int = FAULTY, sound: int = SOUND, seed: int = SEED) -> dict[str, Any]:
    """Draw faults and sound controllers, and audit them."""
    rng = np.random.default_rng(seed)
    machines = [load_machine(name) for name in ("carm", "turntable", "emps")]
    cases = []
    for number in range(faulty):
        machine, kind = machines[rng.integers(len(machines))], KINDS[number % len(KINDS)]
        fault = drawn(rng, kind, machine)
        (audit, *_) = audit_controllers(machine, [closed_loop(machine, rng, fault) for _ in range(2)])
        cases.append({"machine": machine.name, "fault": fault, "found": is_found(audit, fault, machine), "said": audit.said})
    accused = []
    for number in range(sound):
        machine = machines[number % len(machines)]
        (audit, *_) = audit_controllers(machine, [closed_loop(machine, rng, {})])
        if audit.status != "as_filed":
            accused.append({"machine": machine.name, "said": audit.said})
    return {
        "seed": seed,
        "faults": faulty,
        "found": sum(case["found"] for case in cases),
        "sound": sound,
        "accused": accused,
        "cases": cases,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, default=RESULTS, metavar="FILE", help="result file (%(default)s)")
    arguments = parser.parse_args()
    result = measured()
    arguments.json.write_text(json.dumps(result, indent=1) + "\n")
    for case in result["cases"]:
        print(("found   " if case["found"] else "missed  ") + f"{case['machine']} {case['fault']}: {case['said']}")
    for case in result["accused"]:
        print(f"accused {case['machine']}: {case['said']}")
    print(f"{result['found']} of {result['faults']} faults found, {len(result['accused'])} of {result['sound']} sound controllers accused")


if __name__ == "__main__":
    main()
