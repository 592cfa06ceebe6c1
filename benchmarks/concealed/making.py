"""Making cases: the machines' models exported by the command, each case built in its own process, its truth hashed."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from concealed.truth.build import make_case
from concealed.truth.draw import ORDER, Case, draw
from concealed.truth.plant import Machine

HERE = Path(__file__).parent
SHIPPED = "carm"
SHIPPED_MACHINES = HERE.parents[1] / "hil" / "machine" / "shipped"
OWN = ("tilted_arm", "slider", "pan_tilt", "spring_mass")
COMMAND = str(Path(sys.executable).with_name("isocenter"))


@dataclass(frozen=True)
class Places:
    """Where a set of cases lives: what the tool sees, what the scorer sees, what the tool answered."""

    work: Path
    seeds: str

    @property
    def models(self) -> Path:
        return self.work / "models"

    def case(self, number: int) -> Path:
        """Recordings and machine file."""
        return self.work / self.seeds / "cases" / f"{number:04d}"

    def truth(self, number: int) -> Path:
        """Sealed: opened by the scorer alone."""
        return self.work / self.seeds / "truths" / f"{number:04d}.json"

    def answer(self, number: int) -> Path:
        """What diagnose wrote."""
        return self.work / self.seeds / "answers" / f"{number:04d}"


def seeds(name: str) -> tuple[int, int]:
    """Base seed and number of cases of a set."""
    table = tomllib.loads((HERE / "seeds.toml").read_text(encoding="utf-8"))[name]
    return int(table["seed"]), int(table["cases"])


def export_models(places: Places) -> None:
    """Write every machine file and its MJCF, by the command, once."""
    places.models.mkdir(parents=True, exist_ok=True)
    for name in (*OWN, SHIPPED):
        machine, model = places.models / f"{name}.toml", places.models / f"{name}.xml"
        source = SHIPPED_MACHINES if name == SHIPPED else HERE / "machines"
        machine.write_bytes((source / f"{name}.toml").read_bytes())
        subprocess.run([COMMAND, "machine", "export", str(machine), "--mjcf", str(model)], check=True, capture_output=True)


@cache
def machines(models: Path) -> dict[str, Machine]:
    """The exported machines."""
    return {name: Machine(models / f"{name}.toml", models / f"{name}.xml") for name in (*OWN, SHIPPED)}


def case_of(places: Places, number: int) -> Case:
    """The case of this number, not yet made."""
    return draw(number, seeds(places.seeds)[0], machines(places.models))


def make(places: Places, number: int) -> None:
    """Make one case, unless it is there: its truth, which is written last, and its recordings, which are removed once they are answered.

    A run that was killed may have removed recordings whose answer it had not written down.
    """
    if places.truth(number).exists() and places.case(number).is_dir():
        return
    case = case_of(places, number)
    make_case(case, machines(places.models)[case.machine], places.case(number), places.truth(number))


def seal(path: Path) -> str:
    """SHA-256 of a truth, without reading what it says."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def stratum_of(number: int) -> str:
    """Which stratum a case belongs to, without drawing it."""
    return ORDER[number % len(ORDER)]
