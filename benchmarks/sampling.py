"""What the emulated bus samples at a SYNC, beside an axis written at steps of 20 µs that shares nothing with it.

    python benchmarks/sampling.py

A turntable with an IMU is run on the emulator, each time with another drive. The targets on the bus move the axis of `small_steps.py`,
which begins where the emulator's truth file says; what it shows at every SYNC is held against the recorded rows. Numbers of the table are
written here again, as its data sheet would have them. Answers go to results/sampling.json.
"""

from __future__ import annotations

import json
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.signal
from small_steps import Axis, Motion, moved, smoothed

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Jog, JogOnly
from hil.machine import Machine, load_machine, machine_from_text
from hil.recording import read_recording
from virtual_bus.settings import EffectSetting

RESULTS = Path(__file__).parent / "results" / "sampling.json"
PERIOD_s = 0.005
ARM_m, CORNER_Hz = 0.4, 40.0
"""Of the IMU: how far from the table's axis, and its low pass."""
IMU = f"""
[sensors.imu]
type = "imu"
body = "table"
position_m = [{ARM_m}, 0.0, 0.1]
orientation_deg = [0.0, 0.0, 0.0]
accelerometer_noise_rms_m_s2 = [0.0, 0.0, 0.0]
accelerometer_bias_m_s2 = [0.0, 0.0, 0.0]
accelerometer_bandwidth_Hz = {CORNER_Hz}
accelerometer_resolution_m_s2 = 0.0001
gyro_noise_rms_rad_s = [0.0, 0.0, 0.0]
gyro_bias_rad_s = [0.0, 0.0, 0.0]
gyro_bandwidth_Hz = {CORNER_Hz}
gyro_resolution_rad_s = 0.00001

[bus.imu]
sensor = "imu"
baud = 921600
triggered_by_sync = true
rate_Hz = 200.0
"""
SPEED_PDO = """
[[bus.nodes.turn_drive.tpdo]]
number = 2
cob_id = 0x281
transmission_type = 1
map = ["velocity_actual_value"]
"""
"""A further TPDO, which no recording holds: it is read off the frames."""
TABLE = Axis(inertia_kg_m2=7.0 + 6.0e-5 * 100.0**2, damping_Nm_s=23.0, Nm_A=0.095 * 100.0)
STEP_A = 0.005
"""A per mille of the drive's rated current."""
COUNTS = {
    "position_turn": 2.0 * math.pi / (4096 * 100),
    "link_position_turn": 2.0 * math.pi / 8388608,
    "current_turn": STEP_A,
    "imu_x": 1e-4,
    "imu_y": 1e-4,
    "gyro_z": 1e-5,
    "velocity_actual_value": 2.0 * math.pi / (4096 * 100) / PERIOD_s,
}
"""One count of each channel [rad, A, m/s², rad/s]; of the drive's speed, a count of its encoder in a row [rad/s]."""
BEFORE = 16
"""Rows whose targets a late drive may still act on in row 0."""
SPEED_SHARE = 0.25
"""Of the newest difference in the drive's speed, as docs/explanation/emulated-devices.md has it."""


@dataclass(frozen=True)
class Convention:
    """A drive whose readings are compared.

    Attributes
    ----------
    name : str
    axis : Axis
        As the witness has it.
    effects : tuple of EffectSetting
        As the emulator has it.
    """

    name: str
    axis: Axis = TABLE
    effects: tuple[EffectSetting, ...] = ()


def late(delay_s: float = 0.0, natural_Hz: float = 0.0) -> tuple[Axis, tuple[EffectSetting, ...]]:
    """Return a drive with a delay, a current loop or both, as both sides have it."""
    axis = Axis(TABLE.inertia_kg_m2, TABLE.damping_Nm_s, TABLE.Nm_A, delay_s, natural_Hz, 0.7)
    effects = [EffectSetting("delay", "turn", {"Td": delay_s})] if delay_s else []
    effects += [EffectSetting("drive_bandwidth", "turn", {"fc": natural_Hz, "zeta": 0.7})] if natural_Hz else []
    return axis, tuple(effects)


CONVENTIONS = (
    Convention("a target acts from its SYNC to the next"),
    Convention("delay of 0.3 rows", *late(0.0015)),
    Convention("delay of 1 row", *late(0.005)),
    Convention("delay of 2.4 rows", *late(0.012)),
    Convention("delay of 3 rows", *late(0.015)),
    Convention("current loop at 60 Hz", *late(natural_Hz=60.0)),
    Convention("delay of 2.4 rows, current loop at 60 Hz", *late(0.012, 60.0)),
)


@dataclass(frozen=True, eq=False)
class Emulated:
    """What the emulator gives.

    Attributes
    ----------
    rows : dict of str to (N,) array
        Channels by name.
    targets, before : (N,), (M,) arrays
        Of torque [A], at each SYNC of the rows and at those before, off the bus.
    position, speed : float
        True ones in row 0 [rad, rad/s].
    """

    rows: dict[str, np.ndarray]
    targets: np.ndarray
    before: np.ndarray
    position: float
    speed: float


def emulated(machine: Machine, effects: tuple[EffectSetting, ...]) -> Emulated:
    """Run a jog on the emulator, without noise."""
    (plan,) = JogOnly(jog=Jog(math.radians(8.0), line=1), period_s=3.0, periods=1).plans(machine)
    with tempfile.TemporaryDirectory() as folder:
        rows, truth, frames = (Path(folder) / name for name in ("rows.mf4", "truth.csv", "frames.log"))
        options = BenchOptions("lockstep:", noise=False, emulated=machine.with_effects(effects), truth=truth, frame_log=frames)
        with open_bench(machine, options, plan.start_pose) as bench:
            bench.run(plan, rows)
        recording = read_recording(rows)
        true = np.genfromtxt(truth, delimiter=",", names=True, deletechars="")
        lines = frames.read_text(encoding="utf-8").splitlines()
    names = list(true.dtype.names or ())
    first = true[0]
    position, speed = (next(float(first[name]) for name in names if name.startswith(kind)) for kind in ("joint_position", "joint_speed"))
    channels = {name: recording[name] for name in COUNTS if name in recording}
    positions, speeds = objects(lines, "181", 2), objects(lines, "281", 0)
    begin = found_in(np.round(recording["position_turn"] / COUNTS["position_turn"]).astype(np.int64), positions)
    channels["velocity_actual_value"] = speeds[begin : begin + recording.rows] * COUNTS["position_turn"]
    targets = targets_at_syncs(lines)[-len(positions) :] * STEP_A
    return Emulated(channels, targets[begin : begin + recording.rows], targets[begin - BEFORE : begin], position, speed)


def targets_at_syncs(lines: list[str]) -> np.ndarray:
    """Return the last target of torque [per mille] before each SYNC (SYNCs,)."""
    found, last = [], 0
    for line in lines:
        identifier, data = line.split()[-1].split("#")
        if identifier == "201":
            last = int.from_bytes(bytes.fromhex(data)[2:4], "little", signed=True)
        elif identifier == "080":
            found.append(last)
    return np.array(found)


def objects(lines: list[str], identifier: str, first: int) -> np.ndarray:
    """Return the numbers of 32 bits from this byte on in all frames with this identifier (frames,)."""
    data = [bytes.fromhex(line.split("#")[1]) for line in lines if f" {identifier}#" in line]
    return np.array([int.from_bytes(each[first : first + 4], "little", signed=True) for each in data])


def found_in(rows: np.ndarray, frames: np.ndarray) -> int:
    """Return where the rows' counts begin among those of the frames, which may count from elsewhere."""
    places = range(len(frames) - len(rows), -1, -1)
    return next(k for k in places if np.ptp(frames[k : k + len(rows)] - rows) <= 1)


def shown(motion: Motion) -> dict[str, np.ndarray]:
    """Return what the sensors show at every SYNC (N,), before they round."""
    differences = np.diff(motion.position[:, 0], prepend=motion.position[0, 0]) / PERIOD_s
    return {
        "position_turn": motion.position[:, 0],
        "link_position_turn": motion.position[:, 0],
        "current_turn": motion.current[:, 0],
        "imu_x": smoothed(-ARM_m * motion.mean_speed**2, CORNER_Hz)[:, 0],
        "imu_y": smoothed(ARM_m * motion.mean_acceleration, CORNER_Hz)[:, 0],
        "gyro_z": smoothed(motion.mean_speed, CORNER_Hz)[:, 0],
        "velocity_actual_value": scipy.signal.lfilter([SPEED_SHARE], [1.0, SPEED_SHARE - 1.0], differences),
    }


def compared(axis: Axis, there: Emulated) -> dict[str, dict[str, float]]:
    """Return by channel both values where they are furthest apart, and how far that is in counts, beyond the half that rounding makes."""
    wanted = shown(moved(axis, there.targets, there.before, PERIOD_s, there.position, there.speed))
    found = {}
    for name, count in COUNTS.items():
        k = int(np.nanargmax(np.abs(there.rows[name] - wanted[name])))
        has, asked = float(there.rows[name][k]), float(wanted[name][k])
        found[name] = {"emulated": has, "witness": asked, "counts": max(abs(has - asked) / count - 0.5, 0.0)}
    return found


def with_all_sensors() -> Machine:
    """Return the turntable with an IMU, and its drive's speed on the bus."""
    before, after = load_machine("turntable").text.split("[[bus.nodes.turn_drive.rpdo]]", 1)
    return machine_from_text(f"{before}{SPEED_PDO}[[bus.nodes.turn_drive.rpdo]]{after}{IMU}")


def main() -> None:
    """Compare all, print a table and keep it."""
    machine = with_all_sensors()
    found = {each.name: compared(each.axis, emulated(machine, each.effects)) for each in CONVENTIONS}
    for name, channels in found.items():
        print(name)
        for channel, one in channels.items():
            print(f"  {channel:22} {one['emulated']:12.6g} {one['witness']:12.6g} {one['counts']:8.2f} counts of {COUNTS[channel]:.3g}")
    kept = {name: {channel: rounded(one) for channel, one in channels.items()} for name, channels in found.items()}
    RESULTS.write_text(json.dumps({"count": rounded(COUNTS), "conventions": kept}, indent=1) + "\n", encoding="utf-8")


def rounded(values: dict[str, float]) -> dict[str, float]:
    """Return them with six digits."""
    return {name: float(f"{value:.6g}") for name, value in values.items()}


if __name__ == "__main__":
    main()
