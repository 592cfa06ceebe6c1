"""Mutation testing of what keeps the machine safe: do the tests notice when a line of it is made wrong?

mutmut makes one small change at a time (a `<` becomes `<=`, a number grows by one, an argument is left out) and runs the tests that reach
the function. A mutant that a test notices is killed; one that no test notices has survived. Tried are the supervisor, the stop of an axis,
the watch over its motion and its bus, what these are in a whole machine, the judges of the sensors, the loop's side of the supervisor,
the limits that the sample loop checks, the frames of its tick, and what gives drives their power and opens brakes. One command, which goes
on where it was stopped:

    python benchmarks/mutation.py
    python benchmarks/mutation.py supervisor --sample 50

It ends with status 1 where fewer died than are asked.
The work is kept in build/mutation; after a change of the code the changed functions alone are tried again, after a change of the tests
all that had survived. `--sample` tries so many mutants of each module, drawn with `--seed`. Survivors that no test can notice, because
the program does the same with them, are named with the reason in mutation_equivalents.toml; a reason whose mutant is no more is told.
mutmut leaves alone what stands outside of functions, and functions with a decorator (properties).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
RESULTS = Path(__file__).parent / "results" / "mutation.json"
EQUIVALENTS = Path(__file__).parent / "mutation_equivalents.toml"
MUTMUT = (sys.executable, "-c", "from mutmut.__main__ import cli; cli()")
SHOW_ALL = (
    sys.executable,
    "-c",
    "import sys; from mutmut.__main__ import cli; [cli(['show', name], standalone_mode=False) for name in sys.argv[1:]]",
)
"""`mutmut show` of many mutants: to start Python for each takes longer than to try it."""
NEVER_RUN = "no such mutant"
AT_ONCE = 500  # names on one command line

CODES = {
    **dict.fromkeys((1, 3), "killed"),
    0: "survived",
    **dict.fromkeys((24, -24, 36, 152, 255, -9), "timed_out"),
    **dict.fromkeys((5, 33), "not_covered"),
}
"""mutmut's exit codes; any other, and none, is a mutant that has not been tried to its end."""
OUTCOMES = ("killed", "timed_out", "survived", "not_covered")


class Part(NamedTuple):
    """Modules that are mutated together, and the tests that are to notice."""

    sources: tuple[str, ...]
    tests: tuple[str, ...]
    asked: float  # share of the mutants that die
    without: str = ""  # a test that is left out


CANOPEN, TESTS = "drivers/canopen", "tests/drivers/canopen"
PARTS = {
    "supervisor": Part(
        ("drivers/supervisor", "drivers/shared_memory/supervisor_blocks.py", "drivers/modbus/refresh.py"),
        ("tests/drivers/supervisor", "tests/drivers/modbus/test_refresh.py"),
        0.95,
    ),
    "stop": Part(
        tuple(f"{CANOPEN}/{name}.py" for name in ("quick_stop", "brake_proof", "encoder_path", "hold", "standstill", "stopping")),
        tuple(f"{TESTS}/test_{name}.py" for name in ("quick_stop_bounds", "brake_proof", "hold", "stop_and_master_bounds")),
        0.90,
    ),
    "watch": Part(
        (f"{CANOPEN}/motion_bounds.py", f"{CANOPEN}/one_master.py"),
        (f"{TESTS}/test_motion_bounds.py", f"{TESTS}/test_motion_watch.py", f"{TESTS}/test_stop_and_master_bounds.py"),
        0.90,
    ),
    "whole machine": Part(
        (f"{CANOPEN}/resting.py", f"{CANOPEN}/heartbeat_consumer.py"),
        tuple(
            f"{TESTS}/test_{name}.py"
            for name in ("machine_commissioning", "machine_start", "machine_stop", "heartbeat_consumer", "one_master", "late_answers")
        ),
        0.90,
        # forty whole stops for every mutant would take days, and find less than the stops that are written out
        f"{TESTS}/test_machine_stop.py::test_no_voltage_is_taken_from_an_axis_that_a_brake_does_not_hold",
    ),
    "judges": Part(("drivers/judging",), ("tests/drivers/judging",), 0.90),
    "supervisor link": Part(("drivers/supervisor_link",), ("tests/drivers/supervisor_link",), 0.90),
    "limits": Part(
        ("hil/bench/loop.py",),
        tuple(f"tests/hil/bench/test_{name}.py" for name in ("loop_bounds", "lost_ticks_in_the_loop", "sample_loop")),
        0.90,
    ),
    "tick": Part(
        (f"{CANOPEN}/cyclic.py",),
        tuple(f"{TESTS}/test_{name}.py" for name in ("tick_bounds", "late_answers", "late_bus", "machine_tick")),
        0.90,
    ),
    "start": Part((f"{CANOPEN}/power_and_brakes.py",), (f"{TESTS}/test_power_and_brakes_bounds.py",), 0.90),
}
"""The fewest tests that say what a module is to do: each mutant runs all of them that reach it, until one fails."""


class Tree:
    """A copy of the project, in which a part's mutants are made and tried."""

    def __init__(self, name: str) -> None:
        self.part = PARTS[name]
        self.folder = ROOT / "build" / "mutation" / name.replace(" ", "_")

    def bring_up_to_date(self) -> bool:
        """Copy what has changed; return whether tests have."""
        listed = subprocess.run(
            ["git", "ls-files", "-z", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
        )
        names = [name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]
        for name in names:
            source, copy = ROOT / name, self.folder / name
            content = source.read_bytes() + (self._settings(names).encode() if name == "pyproject.toml" else b"")
            if not copy.exists() or copy.read_bytes() != content:
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.write_bytes(content)
        places = (*self.part.tests, "tests/support")
        tests = [ROOT / name for name in sorted(names) if name.endswith(".py") and name.startswith(places)]
        digest = hashlib.sha256(b"".join(path.read_bytes() for path in tests)).hexdigest()
        kept = self.folder.parent / f"{self.folder.name}.tests"
        changed = not kept.exists() or kept.read_text() != digest
        kept.write_text(digest)
        return changed

    def _settings(self, names: Iterable[str]) -> str:
        folders = sorted({name.partition("/")[0] for name in names} - {"pyproject.toml"})
        without = [f"--deselect={self.part.without}"] if self.part.without else []
        table = {
            "source_paths": list(self.part.sources),
            "pytest_add_cli_args_test_selection": list(self.part.tests),
            "pytest_add_cli_args": ["-p", "no:cacheprovider", *without],
            "also_copy": folders,
            "on_dependency_change": "ignore",
            "timeout_multiplier": 6.0,
        }
        return "\n[tool.mutmut]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())

    def mutmut(self, *words: str, quiet: bool = False) -> str:
        """Run mutmut in the copy; return what it prints, where it is to be quiet."""
        out = subprocess.PIPE if quiet else None
        done = subprocess.run(
            [*MUTMUT, *words], cwd=self.folder, stdout=out, stderr=subprocess.STDOUT if quiet else None, text=True, check=False
        )
        return done.stdout or ""

    def codes(self) -> dict[str, dict[str, int | None]]:
        """Return mutmut's exit codes, by module and mutant."""
        found = {}
        for path in sorted((self.folder / "mutants").rglob("*.py.meta")):
            module = path.relative_to(self.folder / "mutants").with_suffix("").as_posix()
            if codes := json.loads(path.read_text(encoding="utf-8"))["exit_code_by_key"]:
                found[module] = codes
        return found

    def run(self, processes: int, sample: int, seed: int) -> dict[str, list[str]]:
        """Try what has not been tried; return the mutants of each module that were chosen."""
        if self.bring_up_to_date():
            (self.folder / "mutants" / "mutmut-stats.json").unlink(missing_ok=True)  # which test reaches what
            again = {"survived", "not_covered"}
        else:
            again = set()
        said = self.mutmut("run", NEVER_RUN, quiet=True)  # makes the mutants, and times the tests
        codes = self.codes()
        if "nothing matches" not in said or not codes:
            sys.exit(f"mutmut cannot begin:\n{said}")
        chosen = {module: chosen_of(list(names), sample, f"{seed} {module}") for module, names in codes.items()}
        left = [name for module, names in chosen.items() for name in names if CODES.get(codes[module][name], "") in {"", *again}]
        for begin in range(0, len(left), AT_ONCE):
            self.mutmut("run", "--max-children", str(processes), *left[begin : begin + AT_ONCE])
        return chosen


def chosen_of(names: list[str], sample: int, seed: str) -> list[str]:
    """Return all names, or a sample of them; a larger sample holds the smaller one."""
    drawn = list(names)
    random.Random(seed).shuffle(drawn)
    return drawn[:sample] if sample else names


def changed_lines(shown: Iterable[str]) -> tuple[str, str]:
    """Return the line that a mutant changes, before and after."""
    lines = [line for line in shown if line[:1] in "+-" and not line.startswith(("+++", "---"))]
    was, becomes = ([line[1:].strip() for line in lines if line[:1] == sign] for sign in "-+")
    return "\n".join(was), "\n".join(becomes)


def lines_of(tree: Tree, names: list[str]) -> dict[str, tuple[str, str]]:
    """Return what each mutant changes."""
    shown: dict[str, list[str]] = {name: [] for name in names}
    for begin in range(0, len(names), AT_ONCE):
        done = subprocess.run([*SHOW_ALL, *names[begin : begin + AT_ONCE]], cwd=tree.folder, capture_output=True, text=True, check=True)
        name = ""
        for line in done.stdout.splitlines():
            if line.startswith("# ") and (named := line[2:].rpartition(": ")[0]) in shown:
                name = named
            elif name:
                shown[name].append(line)
    return {name: changed_lines(lines) for name, lines in shown.items()}


def result_of(tree: Tree, chosen: dict[str, list[str]], reasons: dict[tuple[str, str, str], str]) -> dict[str, object]:
    """Gather a part's result, by module and together.

    A mutant that does the same counts as a survivor whatever became of it: a test that fails by itself, on a busy computer, kills it, too.
    """
    modules, codes = {}, tree.codes()
    together: Counter[str] = Counter()
    for module, names in chosen.items():
        lines = lines_of(tree, names)
        known = {name: reasons[(module, *lines[name])] for name in names if (module, *lines[name]) in reasons}
        outcomes = {name: "survived" if name in known else CODES.get(codes[module][name], "untried") for name in names}
        counts = Counter(outcomes.values())
        counts["equivalent"] = len(known)
        counts["killed_though_equivalent"] = sum(CODES.get(codes[module][name]) in ("killed", "timed_out") for name in known)
        survivors = [
            {
                "mutant": name.rpartition(".")[2],
                "was": lines[name][0],
                "becomes": lines[name][1],
                **({"equivalent": known[name]} if name in known else {}),
            }
            for name, outcome in outcomes.items()
            if outcome in ("survived", "not_covered")
        ]
        modules[module] = {"mutants": len(codes[module]), **shares(counts), "survivors": survivors}
        together += counts
    of_all = sum(len(each) for each in codes.values())
    return {"mutants": of_all, **shares(together), "asked_share": tree.part.asked, "left_out_test": tree.part.without, "modules": modules}


def shares(counts: Counter[str]) -> dict[str, float]:
    """Return the counts, and the share that died of all that were tried and of those that do something else."""
    tried = sum(counts[outcome] for outcome in OUTCOMES)
    dead = counts["killed"] + counts["timed_out"]
    return {
        "tried": tried,
        **{outcome: counts[outcome] for outcome in OUTCOMES},
        "equivalent": counts["equivalent"],
        "killed_though_equivalent": counts["killed_though_equivalent"],
        "dead_share": round(dead / max(tried, 1), 4),
        "dead_share_without_equivalent": round(dead / max(tried - counts["equivalent"], 1), 4),
    }


def main() -> None:
    """Run the parts, and keep each as soon as it is there."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(repr(name) for name in PARTS)}; all without")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--sample", type=int, default=0, help="so many mutants of each module; 0: all")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--anew", action="store_true", help="forget what was tried before")
    parser.add_argument("--results", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.parts if name not in PARTS]:
        parser.error(f"no part is called {unknown[0]!r}; there are {', '.join(repr(name) for name in PARTS)}")
    known = tomllib.loads(EQUIVALENTS.read_text(encoding="utf-8"))["mutant"]
    reasons = {(each["module"], each["was"], each["becomes"]): each["reason"] for each in known}
    results = json.loads(arguments.results.read_text(encoding="utf-8")) if arguments.results.exists() else {}
    too_few = []
    for name in arguments.parts or PARTS:
        tree = Tree(name)
        if arguments.anew:
            shutil.rmtree(tree.folder, ignore_errors=True)
        chosen = tree.run(arguments.processes, arguments.sample, arguments.seed)
        drawn = {"sample_of_each_module": arguments.sample, "seed": arguments.seed} if arguments.sample else {}
        part = {**drawn, **result_of(tree, chosen, reasons)}
        results = {key: part if key == name else results[key] for key in PARTS if key == name or key in results}
        arguments.results.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(f"{name}: {part['dead_share']:.1%} of {part['tried']} mutants died, {part['asked_share']:.0%} are asked")
        too_few += [name] if part["dead_share"] < part["asked_share"] else []
        lines = {(module, each["was"], each["becomes"]) for module, of in part["modules"].items() for each in of["survivors"]}
        if not arguments.sample:
            for module, was, becomes in sorted(set(reasons) - lines):
                if module in part["modules"]:
                    print(f"{EQUIVALENTS.name}: {module}: no mutant makes {was!r} {becomes!r}")
    if too_few:
        sys.exit(f"too few mutants died: {', '.join(too_few)}")


if __name__ == "__main__":
    main()
