"""Frequencies and dampings that `isocenter identify` lists, with their bounds, against the plants' own: both C-arms, with and without jog.

    python benchmarks/identification_resonances.py --out benchmarks/results/identification_resonances.json

At each pose and seed: 4 realisations of 2 orthogonal experiments of 4 periods of 20 s, every line from 1 to 40 Hz, sensors' noise; what
scatters from run to run is drawn for each. True is the plant about the pose in sliding, with its viscous friction and without the dry one.
A mode counts as found where a listed resonance is within a tenth of its frequency. Error and stated deviation are root mean squares over
poses and seeds, of a damping ratio relative to the true one. `G`: errors of the response relative to it, medians over lines and elements of
the root mean squares, and whether what is stated holds: against the plant, and against the mean over the seeds, which is what the
excitation finds again.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from controllers.excitation_lines import Band
from hil.experiments import Jog, Multisine
from hil.identification import FrequencyResponse, identify, resonances
from hil.machine import Machine, load_machine
from hil.observing.simulated_recordings import emulated_recording
from hil.simulation import Simulator
from hil.simulation.linear import sampled_response
from virtual_bus.effects.scatter import drawn
from virtual_bus.physics import Physics

OUTPUTS = ("imu_x", "imu_y", "imu_z", "link_position_propeller", "link_position_roll", "position_propeller", "position_roll")
BAND_Hz = (1.0, 40.0)
POSES = tuple({"propeller": np.radians(10.0), "roll": np.radians(roll)} for roll in (-45.0, 0.0, 60.0))
REALISATIONS, PERIODS = 4, 4
WAYS = {
    "standing, 0.8 A": {"amplitude_A": 0.8, "jog": None},
    "jog, 0.8 A": {"amplitude_A": 0.8},
    "wide jog, 0.8 A": {"amplitude_A": 0.8, "jog": Jog(np.radians(10.0))},
    "jog with constant speed, 0.75 A": {"amplitude_A": 0.75, "jog": Jog(np.radians(5.0), frequency_Hz=0.1, turn_share=0.06)},
}
NEAR = 0.1
"""Of a frequency, within which a listed resonance is taken for a mode."""


def sliding(machine: Machine) -> Machine:
    """Return the machine as its modes see it while it slides: viscous friction, no dry one, and creep, which has no time to yield."""
    damping = {each.at: each.parameters["Fv0"] for each in machine.own_effects if each.name == "temperature_dependent_friction"}
    stiffness = {each.at: each.parameters["k1"] for each in machine.own_effects if each.name == "creep"}
    bodies = []
    for body in machine.plant.tree.bodies:
        joint = body.joint
        if joint is not None:
            more = damping.get(joint.name, 0.0), stiffness.get(body.name, 0.0)
            body = replace(body, joint=replace(joint, damping=joint.damping + more[0], stiffness=joint.stiffness + more[1]))
        bodies.append(body)
    return replace(machine, plant=replace(machine.plant, tree=replace(machine.plant.tree, bodies=tuple(bodies))))


def true_modes(machine: Machine, pose: np.ndarray) -> np.ndarray:
    """Return natural frequencies [Hz] and damping ratios (modes, 2) in the band, rising."""
    poles = np.linalg.eigvals(Physics(machine.plant, noise=False).linearise(pose).A)
    poles = poles[(poles.imag > 0.0) & (np.abs(poles) > 2.0 * np.pi * BAND_Hz[0]) & (np.abs(poles) < 2.0 * np.pi * BAND_Hz[1])]
    poles = poles[(-poles.real < 0.5 * np.abs(poles)) & (np.abs(poles.imag) > 0.0)]
    poles = poles[np.argsort(np.abs(poles))]
    return np.column_stack((np.abs(poles) / (2.0 * np.pi), -poles.real / np.abs(poles)))


def measured(machine: Machine, pose: dict[str, float], seed: int, way: dict) -> FrequencyResponse:
    """Return the robust BLA of one pose; every recording is a run of its own."""
    experiment = Multisine(pose=pose, lines=Band(*BAND_Hz), periods=PERIODS, realisations=REALISATIONS, seed=seed, **way)
    recordings = []
    for number, plan in enumerate(experiment.plans(machine)):
        run = 100 * seed + number
        settings = replace(machine.plant, effects=drawn(machine.plant.effects, run, machine.plant))
        recordings.append(emulated_recording(machine, plan, run, Simulator(replace(machine, plant=settings))))
    return identify(recordings, "robust_bla", outputs=OUTPUTS)


def judged(machine: Machine, way: dict, seeds: int) -> dict:
    """Return the rows of the modes, and of the response."""
    plain = sliding(machine)
    errors: dict[int, list[np.ndarray]] = {}
    responses = []
    for number, pose in enumerate(POSES):
        at = np.array([pose[axis] for axis in machine.axes])
        true = true_modes(plain, at)
        of_pose = []
        for seed in range(seeds):
            response = measured(machine, pose, 10 * number + seed, way)
            of_pose.append(response)
            found = resonances(response)
            listed = np.array([(each.frequency_Hz, each.damping) for each in found.found]).reshape(-1, 2)
            for k, mode in enumerate(true):
                near = np.abs(listed[:, 0] / mode[0] - 1.0) if len(listed) else np.array([np.inf])
                errors.setdefault(k, [])
                if near.min() > NEAR:
                    continue
                best = int(np.argmin(near))
                stated = np.sqrt(np.diagonal(found.found[best].covariance)) / mode
                errors[k].append(np.array([*(listed[best] / mode - 1.0), *stated, *mode]))
            print(
                f"{machine.name}, roll {np.degrees(pose['roll']):.0f}, seed {seed}: {listed.round(4).tolist()}", file=sys.stderr, flush=True
            )
        truth = sampled_response(plain, at, of_pose[0].frequencies_Hz, OUTPUTS)
        responses.append((of_pose, truth))
    rows = {}
    for k, of_mode in errors.items():
        rows[f"mode {k + 1}"] = {"found": len(of_mode), "of": len(POSES) * seeds} | (_row(np.array(of_mode)) if of_mode else {})
    return {"modes": rows, "G": _response_row(responses)}


def _row(of: np.ndarray) -> dict[str, float]:
    """Return errors [%] of a mode's estimates (N, 6): errors, stated deviations, true values."""
    row = {}
    for j, name in enumerate(("frequency", "damping")):
        error, stated = np.sqrt(np.mean(of[:, j] ** 2)), np.sqrt(np.mean(of[:, 2 + j] ** 2))
        row |= {
            f"{name}_true": float(of[:, 4 + j].mean()),
            f"{name}_bias_percent": 100.0 * float(of[:, j].mean()),
            f"{name}_error_percent": 100.0 * float(error),
            f"{name}_stated_percent": 100.0 * float(stated),
            f"{name}_ratio": float(stated / error),
        }
    return row


def _response_row(responses: list[tuple[list[FrequencyResponse], np.ndarray]]) -> dict[str, float]:
    wrong, again, stated = [], [], []
    for of_pose, truth in responses:
        G = np.array([each.G for each in of_pose])
        size = np.abs(truth)
        wrong.append(np.sqrt(np.mean(np.abs(G - truth) ** 2, axis=0)) / size)
        again.append(np.sqrt(np.sum(np.abs(G - G.mean(axis=0)) ** 2, axis=0) / max(len(G) - 1, 1)) / size)
        stated.append(np.sqrt(np.mean([each.standard_deviation("total") ** 2 for each in of_pose], axis=0)) / size)
    medians = [float(np.median(each)) for each in (wrong, again, stated)]
    squares = [np.sqrt(np.mean(np.array(each) ** 2 / np.array(stated) ** 2)) for each in (wrong, again)]
    names = ("error_percent", "scatter_percent", "stated_percent")
    row = {name: 100.0 * value for name, value in zip(names, medians, strict=True)}
    if medians[1] > 0.0:  # of several seeds
        row["ratio_to_scatter"] = medians[2] / medians[1]
    return row | {"ratio": medians[2] / medians[0], "rms_error_over_stated": float(squares[0])}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", action="append", help="carm, carm-real (both unless given)")
    parser.add_argument("--way", action="append", choices=WAYS, help="all unless given")
    parser.add_argument("--seeds", type=int, default=3)
    default = Path(__file__).parent / "results" / "identification_resonances.json"
    parser.add_argument("--out", type=Path, default=default, help="the answer; what is in it already is not measured again")
    options = parser.parse_args()
    kept = json.loads(options.out.read_text()) if options.out.exists() else {"seeds": options.seeds, "modes": {}, "response": {}}
    for way in options.way or WAYS:
        for name in options.machine or ["carm", "carm-real"]:
            if name in kept["response"].get(way, {}):
                continue
            found = judged(load_machine(name), WAYS[way], options.seeds)
            kept["response"].setdefault(way, {})[name] = found["G"]
            for mode, row in found["modes"].items():
                kept["modes"].setdefault(f"{way}: {mode}", {})[name] = row
            options.out.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
