"""Modal model of the emulated C-arm fitted from identified responses, judged at poses held out, against the plant's own linearisation.

    python benchmarks/identification_modal.py [--out benchmarks/results/identification_modal.json] [--figure modes.png]

49 roll positions from -90 to 90 degrees; at each 7 realisations of 2 orthogonal experiments of 10 periods of 10 s, every line from 0.5 to
40 Hz, 0.5 A rms, noise 30 dB below the accelerations and 20 dB below the encoders' signals, fed back where the encoders are; robust BLA.
Fitted: 13 poses 15 degrees apart, and 25 poses 7.5 degrees apart; held out: the poses halfway between. Stated: the largest error of natural
frequencies and damping ratios, and the share of elements and lines whose error lies within the 95 % noise bound that a measurement at the
held-out pose itself would have. `--keep` holds the responses for another run.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.polynomial import legendre

from hil.figures.modes import modes_figure
from hil.identification import FrequencyResponse, fit_modal_model, periodic_records, read_frf, robust_bla, write_frf
from hil.machine import Machine, load_machine
from hil.simulation import Inputs, Simulator
from hil.simulation.linear import sampled_response
from virtual_bus.physics import Physics

OUTPUTS = ("imu_x", "imu_y", "imu_z", "position_propeller", "position_roll")
INPUTS = ("command_propeller", "command_roll")
PERIOD, SETTLE, PERIODS, REALISATIONS = 2560, 2, 10, 7
LINES = np.arange(5, 401)  # 0.5 to 40 Hz
EXCITATION_RMS_A = 0.5
SNR_DB = (30.0, 20.0)
PROPELLER_RAD = np.radians(10.0)
ROLL_RAD = np.radians(np.linspace(-90.0, 90.0, 49))
FITTED = {"13 poses, 15 degrees apart": 4, "25 poses, 7.5 degrees apart": 2}


def orthogonal_multisine(rng: np.random.Generator) -> np.ndarray:
    """(2 experiments, period, 2 inputs) of the excitation's rms."""
    phases = np.exp(2j * np.pi * rng.random((2, len(LINES), 2)))
    spectrum = np.zeros((2, PERIOD // 2 + 1, 2), complex)
    for e, signs in enumerate(((1, 1), (1, -1))):
        spectrum[e, LINES] = phases[0] * phases[1][:, e : e + 1] * signs
    period = np.fft.irfft(spectrum, PERIOD, axis=1)
    return period * EXCITATION_RMS_A / period.std()


def measured(simulator: Simulator, pose: np.ndarray, rng: np.random.Generator) -> FrequencyResponse:
    """Robust BLA at one pose."""
    rows = (SETTLE + PERIODS) * PERIOD
    y, u, w = (np.empty((REALISATIONS, 2, rows, n)) for n in (len(OUTPUTS), 2, 2))
    level = np.zeros(len(OUTPUTS))
    for m in range(REALISATIONS):
        w[m] = np.tile(orthogonal_multisine(rng), (1, SETTLE + PERIODS, 1))
        for e in range(2):

            def run(encoder_noise: np.ndarray, excitation: np.ndarray = w[m, e]):
                return simulator.run(Inputs(np.tile(pose, (rows, 1)) - encoder_noise, excitation, np.zeros((rows, 2)), None, pose))

            if not level.any():
                clean = run(np.zeros((rows, 2)))
                acceleration, encoder = clean.imu[SETTLE * PERIOD :, :3].std(axis=0), clean.position[SETTLE * PERIOD :].std(axis=0)
                level = np.concatenate((np.full(3, acceleration.max()) * 10 ** (-SNR_DB[0] / 20), encoder * 10 ** (-SNR_DB[1] / 20)))
            noise = level * rng.standard_normal((rows, len(OUTPUTS)))
            noisy = run(noise[:, 3:])  # noise on an encoder is fed back
            y[m, e], u[m, e] = np.column_stack((noisy.imu[:, :3], noisy.position)) + noise, noisy.command
    records = periodic_records(
        y, u, w, period_samples=PERIOD, sample_rate_Hz=256.0, settle_periods=SETTLE, output_names=OUTPUTS, input_names=INPUTS,
        pose=tuple(pose),
    )  # fmt: skip
    return robust_bla(records)


def responses_over_poses(machine: Machine, keep: Path | None) -> list[FrequencyResponse]:
    simulator = Simulator(machine)
    made = []
    for index, roll in enumerate(ROLL_RAD):
        kept = None if keep is None else keep / f"{index}.npz"
        if kept is not None and kept.exists():
            made.append(read_frf(kept))
            continue
        made.append(measured(simulator, np.array([PROPELLER_RAD, roll]), np.random.default_rng((5, index))))
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_frf(made[-1], kept)
        print(f"pose {index + 1} of {len(ROLL_RAD)}", flush=True)
    return made


def true_modes(plant: Physics, pose: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Natural frequencies [Hz] and damping ratios in the band, of the plant's own state matrix."""
    poles = np.linalg.eigvals(plant.linearise(np.asarray(pose)).A)
    at_Hz = np.abs(poles) / (2 * np.pi)
    poles = poles[(poles.imag > 0.0) & (at_Hz > LINES[0] * 256.0 / PERIOD) & (at_Hz < LINES[-1] * 256.0 / PERIOD)]
    poles = poles[np.argsort(np.abs(poles))]
    return np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)


def judged(machine: Machine, responses: list[FrequencyResponse], step: int, figure: Path | None) -> dict:
    plant = Physics(machine.plant, noise=False)
    start = time.process_time()
    model = fit_modal_model(responses[::step], 1)
    seconds = time.process_time() - start
    frequency, damping, below, itself = [], [], [], []
    for response in responses[step // 2 :: step]:
        truth = sampled_response(machine, np.array(response.pose), response.frequencies_Hz, OUTPUTS)
        bound = response.bound(0.95, "noise")
        below.append(np.mean(np.abs(model.response(response.pose[1], response.frequencies_Hz) - truth) <= bound))
        itself.append(np.mean(np.abs(response.G - truth) <= bound))
        true_Hz, true_damping = true_modes(plant, response.pose)
        found_Hz, found_damping, _, _ = model.modes(response.pose[1])
        frequency.append(np.abs(found_Hz / true_Hz - 1.0))
        damping.append(np.abs(found_damping / true_damping - 1.0))
    if figure is not None:
        modes_figure(model, title="Modes of the emulated C-arm over roll").savefig(figure, dpi=110)
    return {
        "modes": len(model.alone[0]),
        "poles outside the band": [block.order for block in model.fit.blocks if not block.is_mode],
        "orders of the modes' polynomials": [[len(c) - 1 for c in block.coefficients] for block in model.fit.blocks if block.is_mode],
        "misfit": round(model.fit.misfit, 3),
        "largest error of a natural frequency [%]": round(100 * float(np.max(frequency)), 4),
        "largest error of a damping ratio [%]": round(100 * float(np.max(damping)), 3),
        "within the noise bound": round(float(np.mean(below)), 4),
        "within the noise bound, per held-out pose": [round(float(value), 3) for value in below],
        "measured there, within its own noise bound": round(float(np.mean(itself)), 4),
        "processor time of the fit [s]": round(seconds, 1),
    }  # fmt: skip


def interpolated_frequencies(machine: Machine) -> dict[str, float]:
    """Largest error [%] halfway between 13 poses of the plant's own lowest frequency put through polynomials of order 8, by form."""
    plant = Physics(machine.plant, noise=False)
    omega2 = np.array([true_modes(plant, (PROPELLER_RAD, roll))[0][0] ** 2 for roll in ROLL_RAD])
    x, fitted, between = ROLL_RAD / ROLL_RAD[-1], slice(0, None, 4), slice(2, None, 4)
    errors = {}
    for name, power in (("omega^2", 1.0), ("1 / omega^2", -1.0)):
        found = legendre.legval(x, legendre.legfit(x[fitted], omega2[fitted] ** power, 8)) ** (1.0 / power)
        errors[name] = round(100.0 * float(np.max(np.abs(np.sqrt(found / omega2) - 1.0)[between])), 3)
    return errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "identification_modal.json")
    parser.add_argument("--keep", type=Path, default=None, help="folder of the responses")
    parser.add_argument("--figure", type=Path, default=None, help="modes over the poses, of the last model (.png)")
    parser.add_argument("--machine", default="carm", help="carm, carm-real, or the path of a C-arm's file")
    arguments = parser.parse_args()
    machine = load_machine(arguments.machine)
    responses = responses_over_poses(machine, arguments.keep)
    report: dict[str, dict] = {"lowest frequency of the plant, interpolated [%]": interpolated_frequencies(machine)}
    report |= {name: judged(machine, responses, step, arguments.figure) for name, step in FITTED.items()}
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
