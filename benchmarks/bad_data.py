"""Whether `diagnose` tells wrong recordings as that: `python benchmarks/bad_data.py [FAULT...] [--json FILE] [--work DIR]`.

Sound recordings of shipped machines, made by this script, are spoilt in some thirty ways by the functions below and given to the command.
For each: exit status, verdict, and whether the answer names the channel and what is wrong with it. Sound ones, also those that other people
measured where `real_data.py` finds them, must not be accused. Writes benchmarks/results/bad_data.json unless told otherwise.
"""

from __future__ import annotations

import argparse
import importlib
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.signal
from real_data import DATA

from hil.diagnosis.audit.recordings import faults
from hil.machine import Machine, load_machine
from hil.recording import Channel, Recording, read_recording, recording_metadata, write_recording
from hil.simulation import Inputs, Simulator

RESULTS = Path(__file__).resolve().parent / "results" / "bad_data.json"
SEED = 31
LIMIT_S = 600.0
"""Of one diagnosis: an answer that takes longer counts as none."""

Table = dict[str, tuple[str, np.ndarray]]
"""Unit and values by channel."""


@dataclass(frozen=True)
class Way:
    """One way in which recordings are wrong.

    Attributes
    ----------
    base : str
        Which sound recordings are spoilt.
    status : int
        The right exit status.
    says : str
        Regular expression that the right answer matches.
    spoil : callable
        Of a table, in place.
    raw : callable or None
        Of the file's text, after that.
    files : "all", "first"
        Which recordings are spoilt.
    verdict : str
        Regular expression of the right verdict; "" with status 2.
    """

    base: str
    status: int
    verdict: str
    says: str
    spoil: Callable[[Table], None] = lambda table: None
    raw: Callable[[str], str] | None = None
    files: str = "all"
    has_metadata: bool = True


def change(channel: str, by: Callable[[np.ndarray], np.ndarray]) -> Callable[[Table], None]:
    """Return a spoiler of one channel's values."""

    def spoil(table: Table) -> None:
        for name in [name for name in table if re.fullmatch(channel, name)]:
            table[name] = table[name][0], by(table[name][1].copy())

    return spoil


def swap(*pairs: tuple[str, str]) -> Callable[[Table], None]:
    """Return a spoiler that exchanges the names of channels."""

    def spoil(table: Table) -> None:
        for one, other in pairs:
            table[one], table[other] = table[other], table[one]

    return spoil


def copy(source: str, target: str) -> Callable[[Table], None]:
    """Return a spoiler that gives one channel another one's values."""

    def spoil(table: Table) -> None:
        table[target] = table[target][0], table[source][1].copy()

    return spoil


def rows(of: Callable[[int], Any]) -> Callable[[Table], None]:
    """Return a spoiler that keeps some rows."""

    def spoil(table: Table) -> None:
        kept = of(len(table["time"][1]))
        for name, (unit, values) in table.items():
            table[name] = unit, values[kept]

    return spoil


def late(by: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return a shift to later rows."""
    return lambda values: np.concatenate([np.full(by, values[0]), values[:-by]])


def during(begin: float, end: float, of: Callable[[np.ndarray], Any]) -> Callable[[np.ndarray], np.ndarray]:
    """Return a change of what lies between two shares of the rows."""

    def by(values: np.ndarray) -> np.ndarray:
        part = slice(round(begin * len(values)), round(end * len(values)))
        values[part] = of(values[part])
        return values

    return by


def clip(share: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a limit at a share of the range about its middle."""

    def by(values: np.ndarray) -> np.ndarray:
        middle, half = 0.5 * (values.max() + values.min()), 0.5 * np.ptp(values)
        return np.clip(values, middle - share * half, middle + share * half)

    return by


def low_pass(share: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a Butterworth filter at a share of half the sample rate, as a recorder runs it: forwards."""

    def by(values: np.ndarray) -> np.ndarray:
        return np.asarray(scipy.signal.lfilter(*scipy.signal.butter(2, share), values - values[0]) + values[0])

    return by


def interpolated(every: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return straight lines between each so many rows."""
    return lambda values: np.interp(np.arange(len(values)), np.arange(len(values))[::every], values[::every])


def jittered(time_s: np.ndarray) -> np.ndarray:
    """Return stamps of a host that was busy."""
    period = time_s[1] - time_s[0]
    stamps: np.ndarray = time_s + np.random.default_rng(SEED).uniform(0.0, 0.9 * period, len(time_s))
    return stamps


def spikes(values: np.ndarray) -> np.ndarray:
    """Return readings of which a few are far off."""
    at = np.random.default_rng(SEED).choice(len(values), 5, replace=False)
    values[at] += 3.0 * np.ptp(values)
    return values


def wrapped(values: np.ndarray) -> np.ndarray:
    """Return an angle as a counter of one turn has it."""
    return np.asarray((values + np.pi) % (2.0 * np.pi) - np.pi)


def another(values: np.ndarray) -> np.ndarray:
    """Return what a drive gave in some other experiment, of the same size."""
    time = np.arange(len(values))
    wave = (
        np.sin(2.0 * np.pi * time / 770.0)
        + 0.5 * np.sin(2.0 * np.pi * time / 130.0 + 1.0)
        + 0.1 * np.random.default_rng(SEED).normal(size=len(time))
    )
    return np.asarray(values.std() * wave)


def lines(of: Callable[[list[str]], list[str]]) -> Callable[[str], str]:
    """Return a change of a file's lines behind its header."""

    def raw(text: str) -> str:
        head, *rest = text.splitlines(keepends=True)
        return "".join([head, *of(rest)])

    return raw


DEG = 180.0 / np.pi
T = "turntable"
MOTION = "(link_)?(position|reference)_turn"
BOTH = "(link_)?position_turn"
EFFORTS = "(command|current)_turn"
COPY = copy("position_propeller", "position_roll")
EXCHANGE = swap(("current_propeller", "current_roll"), ("command_propeller", "command_roll"))
M, LACK = "misconfigured", "inconclusive"
WAYS: dict[str, Way] = {
    "no recording at all": Way(T, 2, "", r"\.csv", raw=lambda text: '{"rows": [1, 2, 3]}\n', files="first"),
    "another machine's file": Way(T, 2, "", r"emps.*turntable|position_turn", files="machine"),
    "another machine's channels, renamed": Way(T, 1, M, r"position_turn|current_turn|command_turn", files="renamed"),
    "truncated within a line": Way(T, 2, "", r"cut off|cells", raw=lambda text: text[: len(text) // 2]),
    "truncated after 0.4 s": Way(T, 1, LACK, r"0\.4 s|short|rows|period", rows(lambda n: slice(0, 80)), has_metadata=False),
    "time not monotone": Way(T, 2, "", r"time", raw=lines(lambda rest: [*rest[:500], *rest[700:900], *rest[500:700], *rest[900:]])),
    "rows twice": Way(T, 2, "", r"time|rows", raw=lines(lambda rest: [*rest[:600], *rest[550:]])),
    "time in ms": Way(T, 1, M, r"time.*ms", change("time", lambda v: 1e3 * v)),
    "wrong rate": Way(T, 1, M, r"time.*rows|rows.*(apart|rate)", change("time", lambda v: 2.0 * v)),
    "time stamps with jitter": Way(T, 1, M, r"time.*(jitter|stamp)", change("time", jittered)),
    "half missing": Way(T, 1, LACK, r"position_turn.*missing", change(BOTH, during(0.5, 1, lambda v: np.nan))),
    "blocks of NaN": Way(T, 1, LACK, r"position_turn.*missing", change("position_turn", during(0.4, 0.45, lambda v: np.nan))),
    "all zeros": Way(T, 1, LACK, r"zero|move|0 in", change("(?!time).*", lambda v: 0.0 * v)),
    "constant": Way(T, 1, M, r"position_turn.*(constant|same|stays)", change("position_turn", lambda v: 0.0 * v + v[0])),
    "encoder stuck for a while": Way(T, 1, M, r"position_turn.*stuck", change("position_turn", during(0.4, 0.46, lambda v: v[0]))),
    "position clipped": Way(T, 1, M, r"position_turn.*clipped", change("position_turn", clip(0.7))),
    "the machine hit a stop": Way("stop", 0, "explained|ambiguous", r"end_stop at turn"),
    "position jumps by a turn": Way(T, 1, M, r"position_turn.*jump", change("position_turn", during(0.6, 1, lambda v: v + 2 * np.pi))),
    "position reset": Way(T, 1, M, r"position_turn.*jump", change("position_turn", during(0.6, 1.0, lambda v: v - v[0]))),
    "spikes": Way(T, 1, M, r"position_turn.*(jump|reading)", change("position_turn", spikes)),
    "position in degrees": Way(T, 1, M, r"position_turn.*degrees", change("position_turn", lambda v: DEG * v)),
    "all angles in degrees": Way(T, 1, M, r"degrees", change(MOTION, lambda v: DEG * v)),
    "position in motor turns": Way(T, 1, M, r"position_turn.*(gear|motor)", change(MOTION, lambda v: 100.0 * v)),
    "position's sign": Way(T, 1, M, r"position_turn.*sign", change("position_turn", lambda v: -v)),
    "position late": Way(T, 1, M, r"position_turn.*(late|rows)", change("position_turn", late(6))),
    "effort late": Way(T, 1, M, r"_turn.*(late|rows)", change(EFFORTS, late(6))),
    "effort's sign": Way(T, 1, M, r"_turn.*sign", change(EFFORTS, lambda v: -v)),
    "effort in mA": Way(T, 1, M, r"_turn.*mA", change(EFFORTS, lambda v: 1e3 * v)),
    "current's sign": Way(T, 1, M, r"current_turn.*sign", change("current_turn", lambda v: -v)),
    "current in mA": Way(T, 1, M, r"current_turn.*mA", change("current_turn", lambda v: 1e3 * v)),
    "current late": Way(T, 1, M, r"current_turn.*(late|rows)", change("current_turn", late(25))),
    "current clipped": Way(T, 1, M, r"current_turn.*clipped", change("current_turn", clip(0.5))),
    "command for the current": Way(T, 1, M, r"current_turn.*command_turn", copy("command_turn", "current_turn")),
    "reference for the position": Way(T, 1, M, r"position_turn.*reference_turn", copy("reference_turn", "position_turn")),
    "positions filtered": Way(T, 1, M, r"position_turn.*(filter|smooth)", change(BOTH, low_pass(0.05))),
    "positions interpolated": Way(T, 1, M, r"position_turn.*(interpol|smooth|lines)", change(BOTH, interpolated(4))),
    "aliased": Way(T, 1, LACK, r"(slow|coarse|rate)", rows(lambda n: slice(0, n, 10)), has_metadata=False),
    "efforts of another recording": Way(T, 1, M, r"_turn", change(EFFORTS, another)),
    "axes exchanged": Way("carm", 1, M, r"propeller.*roll|roll.*propeller", swap(("position_propeller", "position_roll"))),
    "roll in degrees": Way("carm", 1, M, r"position_roll.*degrees", change("position_roll", lambda v: DEG * v)),
    "one joint's channel for another's": Way("carm", 1, M, r"position_roll.*position_propeller", COPY),
    "currents exchanged": Way("carm", 1, M, r"propeller.*roll|roll.*propeller", EXCHANGE),
    "speed in rpm": Way("motor", 1, M, r"speed_rotor.*rpm", change("speed_rotor", lambda v: v * 30.0 / np.pi)),
    "speed's sign": Way("motor", 1, M, r"speed_rotor.*sign", change("speed_rotor", lambda v: -v)),
    "open loop, effort in mA": Way("motor", 1, M, r"command_rotor.*(mA|1000)", change("command_rotor", lambda v: 1e3 * v)),
    "open loop, effort's sign": Way("motor", 1, M, r"command_rotor.*sign", change("command_rotor", lambda v: -v)),
    "open loop, position in degrees": Way("motor", 1, M, r"position_rotor.*degrees", change("position_rotor", lambda v: DEG * v)),
    "open loop, jump by a turn": Way("motor", 1, M, r"position_rotor.*jump", change("position_rotor", wrapped)),
    "open loop, efforts exchanged": Way("tx40", 1, M, r"j2.*j3|j3.*j2", swap(("effort_j2", "effort_j3"))),
    "open loop, one effort's sign": Way("tx40", 1, M, r"effort_j2.*sign", change("effort_j2", lambda v: -v)),
    "open loop, arm in degrees": Way("tx40", 1, M, r"degrees", change("position_.*", lambda v: DEG * v)),
}  # fmt: skip


STOP = """
[[effect]]
name = "end_stop"
at = "turn"
K_Nm_rad = 1.0e6
D_Nm_s_rad = 100.0
at_position_rad = 0.40
side = 1.0
"""
RUNS: dict[str, tuple[str, ...]] = {
    "turntable": [
        "multisine",
        "-m",
        "turntable",
        "--pose",
        "turn=20",
        "--band",
        "0.5:40",
        "--amplitude",
        "0.4",
        "--period",
        "5",
        "--periods",
        "3",
        "--jog",
        "5",
        "--jog-frequency",
        "0.4",
    ],
    "stop": ["jog", "-m", "turntable", "--pose", "turn=20", "--amplitude", "5", "--period", "2.5", "--periods", "4"],
    "carm": ["jog", "-m", "carm", "--pose", "propeller=10,roll=30", "--amplitude", "5", "--period", "5", "--periods", "3"],
    "scan": ["scan", "-m", "turntable", "--axis", "turn", "--from", "-40", "--to", "40", "--speed", "20", "--sweeps", "2"],
    "carm shaken": [
        "multisine",
        "-m",
        "carm",
        "--pose",
        "roll=20",
        "--period",
        "10",
        "--periods",
        "1",
        "--jog",
        "3",
        "--experiments",
        "single",
        "--axes",
        "roll",
    ],
    "still": ["static", "-m", "turntable"],
}
"""What is recorded of shipped machines, but for the seed."""
REPEATS = {"turntable": 3, "stop": 3}
MOTOR_ROWS = 6000


def machine_of(base: str) -> Machine:
    """Return the machine whose recordings are spoilt."""
    if base == "motor":
        return load_machine("laas_anti_cogging")
    if base == "tx40":
        machine: Machine = importlib.import_module("real.tx40").splits()["readme"].machine
        return machine
    return load_machine({"stop": "turntable", "scan": "turntable", "still": "turntable", "carm shaken": "carm"}.get(base, base))


def sound(base: str, work: Path, seed: int = SEED) -> dict[str, Recording]:
    """Return sound recordings by name, made once."""
    if base == "motor":
        return {"run": motor(seed)}
    if base == "tx40":
        return {"run": _thinned(*importlib.import_module("real.tx40").splits()["readme"].train.values())}
    found = {}
    for number in range(REPEATS.get(base, 1)):
        path = work / "sound" / f"{base.replace(' ', '_')}_{seed + number}.mf4"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            words = [*RUNS[base], "-b", "lockstep:", "--seed", str(seed + number), "--no-real-time", "-o", str(path)]
            if base == "stop":
                (work / "stop.toml").write_text(STOP)
                words += ["--effects", str(work / "stop.toml")]
            subprocess.run([sys.executable, "-m", "hil", "run", *words], check=True, capture_output=True)
        found[f"r{number + 1}"] = read_recording(path)
    return found


def motor(seed: int) -> Recording:
    """Return a motor in open loop with its speed: a noisy current about a slow wave, which turns it to and fro."""
    machine = load_machine("laas_anti_cogging")
    rng = np.random.default_rng(seed)
    time_s = np.arange(MOTOR_ROWS) / machine.sample_rate_Hz
    command = (
        0.3 * np.sin(2.0 * np.pi * rng.uniform(0.3, 0.6) * time_s)
        + 0.2 * scipy.signal.lfilter([0.02], [1.0, -0.98], rng.normal(size=MOTOR_ROWS)) / 0.1
    )
    none = np.zeros((MOTOR_ROWS, 1))
    outputs = Simulator(machine).run(Inputs(None, none, none, command[:, None], np.zeros(1)))
    channels = {
        "time": Channel("s", time_s),
        "command_rotor": Channel("A", outputs.command[:, 0]),
        "position_rotor": Channel("rad", outputs.position[:, 0]),
        "speed_rotor": Channel("rad/s", outputs.speed[:, 0] + 0.02 * rng.normal(size=MOTOR_ROWS)),
    }
    return Recording(channels, recording_metadata(machine))


def _thinned(recording: Recording) -> Recording:
    """Return every fifth row: a diagnosis takes seconds then."""
    return recording.part(slice(None, None, 5))


def real_ones() -> dict[str, tuple[Machine, Mapping[str, Recording]]]:
    """Return the recordings that other people measured, as far as they are here."""
    if not DATA.is_dir():
        return {}
    found: dict[str, tuple[Machine, Mapping[str, Recording]]] = {}
    for name in ("emps", "silverbox", "laas_anti_cogging", "dfki_double_pendulum", "bam_xl330", "ur5", "tx40", "damiao"):
        for split, data in importlib.import_module(f"real.{name}").splits().items():
            found[f"{name}, {split}"] = data.machine, {**data.train, **data.held_out}
    return found


def written(way: Way, name: str, work: Path) -> tuple[str, list[Path]]:
    """Write what is wrong; return the machine and the files."""
    folder = work / "ways" / re.sub(r"\W+", "_", name)
    folder.mkdir(parents=True, exist_ok=True)
    machine = machine_of(way.base)
    label = machine.name
    if way.base == "tx40":
        label = str(Path(__file__).with_name("real") / "tx40.toml")
    paths = []
    for number, (one, recording) in enumerate(sound(way.base, work).items()):
        path = folder / f"{one}.csv"
        if way.files in ("machine", "renamed"):
            recording = _of_emps(way.files == "renamed", number)
        write_recording(recording, path)
        if way.files != "first" or number == 0:
            table: Table = {key: (channel.unit, channel.values) for key, channel in recording.channels.items()}
            way.spoil(table)
            text = _text(table)
            path.write_text(text if way.raw is None else way.raw(text))
        if not way.has_metadata or way.files == "renamed":
            path.with_suffix(".toml").unlink()
        paths.append(path)
    return label, paths


def _of_emps(is_renamed: bool, number: int) -> Recording:
    """Return a recording of another machine, with its own names or this one's."""
    rng = np.random.default_rng(SEED + number)
    time_s = np.arange(4000) / (200.0 if is_renamed else 1000.0)
    wave = 0.05 * np.sin(2.0 * np.pi * 0.4 * time_s)
    effort = (
        40.0 * np.gradient(np.gradient(wave, time_s), time_s)
        + 6.0 * np.sign(np.cos(2.0 * np.pi * 0.4 * time_s))
        + 0.05 * rng.normal(size=4000)
    )
    if is_renamed:
        columns = {
            "reference_turn": ("rad", wave),
            "command_turn": ("A", effort),
            "position_turn": ("rad", wave + 1e-6 * rng.normal(size=4000)),
        }
    else:
        columns = {"reference_carriage": ("m", wave), "command_carriage": ("V", effort), "position_carriage": ("m", wave)}
    machine = load_machine("turntable" if is_renamed else "emps")
    channels = {"time": Channel("s", time_s), **{key: Channel(*value) for key, value in columns.items()}}
    return Recording(channels, recording_metadata(machine))


def _text(table: Table) -> str:
    head = ",".join(f"{key} [{unit}]" if unit else key for key, (unit, _) in table.items())
    whole = [key.startswith("statusword") or key.endswith("counter") for key in table]
    cells = [
        ["" if np.isnan(v) else str(int(v)) if is_whole else repr(float(v)) for v in values]
        for (_, values), is_whole in zip(table.values(), whole, strict=True)
    ]
    return "\n".join([head, *map(",".join, zip(*cells, strict=True))]) + "\n"


def diagnosed(name: str, work: Path, limit_s: float) -> dict[str, Any]:
    """Give one way's recordings to the command; return what it says."""
    way = WAYS[name]
    machine, paths = written(way, name, work)
    answer = paths[0].parent / "answer.json"
    answer.unlink(missing_ok=True)
    words = [sys.executable, "-m", "hil", "diagnose", machine, *map(str, paths), "-o", str(paths[0].parent / "answer"), "-j", "1"]
    begun = time.monotonic()
    try:
        done = subprocess.run([*words, "--json", str(answer)], capture_output=True, text=True, timeout=limit_s)
    except subprocess.TimeoutExpired:
        return {"status": None, "verdict": "", "said": f"no answer within {limit_s:g} s", "right": False, "seconds": limit_s}
    verdict, said = "", done.stderr.strip().splitlines()[-1] if done.stderr.strip() else ""
    if answer.exists():
        document = json.loads(answer.read_text())
        verdict, said = document["verdict"], document["reason"]
        said += "".join(f" [{one['effect']} at {one['at']} {one['confidence']:.2f}]" for one in document["findings"])
    right = done.returncode == way.status and bool(re.fullmatch(way.verdict, verdict)) and bool(re.search(way.says, said))
    return {
        "status": done.returncode, "verdict": verdict, "said": said.replace(str(work), ""), "right": right,
        "seconds": round(time.monotonic() - begun, 1),
    }  # fmt: skip


def accused(work: Path, seeds: int) -> tuple[int, dict[str, list[str]]]:
    """Return how many sound recordings were looked at, and what is said against them."""
    sets: dict[str, tuple[Machine, Mapping[str, Recording]]] = dict(real_ones())
    for base in ("turntable", "carm", "scan", "carm shaken", "still", "motor"):
        for seed in range(seeds):
            sets[f"{base}, seed {SEED + 100 * seed}"] = machine_of(base), sound(base, work, SEED + 100 * seed)
    found = {}
    for name, (machine, recordings) in sets.items():
        if said := [fault.said for fault in faults(machine, recordings)]:
            found[name] = said
    return len(sets), found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ways", nargs="*", metavar="FAULT", help="of the list in this script; all by default")
    parser.add_argument("--work", type=Path, default=Path("build/bad_data"), metavar="DIR", help="intermediate files (%(default)s)")
    parser.add_argument("--limit", type=float, default=LIMIT_S, metavar="S", help="seconds for one answer (%(default)g)")
    parser.add_argument("--seeds", type=int, default=3, help="of each kind of sound recordings (%(default)s)")
    parser.add_argument("--json", type=Path, default=RESULTS, metavar="FILE", help="result file (%(default)s)")
    arguments = parser.parse_args()
    result = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
    result.setdefault("ways", {})
    for name in arguments.ways or WAYS:
        one = result["ways"][name] = diagnosed(name, arguments.work, arguments.limit)
        print(
            f"{'right' if one['right'] else 'WRONG'} {name}: {one['status']} {one['verdict']} {one['said']} ({one['seconds']} s)",
            flush=True,
        )
        arguments.json.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n")
    if not arguments.ways:
        result["sound"], result["accused"] = accused(arguments.work, arguments.seeds)
        result["accusations"] = len(result["accused"])
        for name, said in result["accused"].items():
            print(f"accused {name}: {'; '.join(said)}")
    result["right"], result["of"] = sum(one["right"] for one in result["ways"].values()), len(result["ways"])
    arguments.json.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n")
    print(f"{result['right']} of {result['of']} right; {len(result.get('accused', {}))} of {result.get('sound', 0)} sound ones accused")


if __name__ == "__main__":
    main()
