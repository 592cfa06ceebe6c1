"""No circle of files or folders anywhere, and every room of `hil` knows only the rooms that it may."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from places import ROOT
from test_floors import FLOORS, imports_of

ROOMS: dict[str, tuple[str, ...]] = {
    "errors": (),
    "extras": (),
    "version": (),
    "pages": ("version",),
    "processes": (),
    "files": ("extras",),
    "machine": ("extras", "files"),
    "recording": ("extras", "files", "machine", "version"),
    "simulation": ("files", "machine", "recording"),
    "experiments": ("files", "machine", "simulation"),
    "identification": ("extras", "files", "recording"),
    "imaging": ("extras", "files", "machine"),
    "calibration": ("experiments", "files", "imaging", "machine", "processes", "recording"),
    "reconstruction": ("extras", "files", "imaging"),
    "shaping": ("experiments", "files", "identification", "machine", "simulation"),
    "observing": ("calibration", "experiments", "files", "identification", "machine", "recording", "simulation"),
    "emulated": ("extras", "files", "imaging", "machine", "processes", "recording"),
    "receiving": ("calibration", "emulated", "extras", "imaging", "machine", "processes", "recording"),
    "bench": ("emulated", "experiments", "files", "machine", "observing", "processes", "recording"),
    "figures": ("calibration", "identification", "imaging", "observing", "pages", "reconstruction", "recording", "shaping"),
    "reports": (
        "calibration",
        "experiments",
        "figures",
        "identification",
        "imaging",
        "machine",
        "observing",
        "pages",
        "reconstruction",
        "recording",
        "shaping",
        "simulation",
    ),
    "diagnosis": ("experiments", "files", "machine", "pages", "processes", "recording", "reports", "simulation"),
    "verbs": (
        "bench",
        "calibration",
        "diagnosis",
        "emulated",
        "experiments",
        "figures",
        "files",
        "identification",
        "imaging",
        "machine",
        "observing",
        "pages",
        "reconstruction",
        "recording",
        "reports",
        "shaping",
        "simulation",
    ),
    "fleet": (
        "calibration",
        "diagnosis",
        "extras",
        "figures",
        "files",
        "identification",
        "imaging",
        "machine",
        "pages",
        "recording",
        "reports",
        "simulation",
        "verbs",
        "version",
    ),
    "terminal": ("files", "recording"),
    "faults": ("bench", "experiments", "machine", "pages", "recording", "reports", "terminal", "version"),
    "conform": (),
    "doctor": ("bench", "emulated", "experiments", "extras", "machine", "processes"),
    "console": ("bench", "emulated", "experiments", "files", "machine", "processes", "recording", "reports", "verbs"),
    "demo": ("bench", "diagnosis", "experiments", "files", "machine", "pages", "recording", "reports", "simulation", "terminal"),
    "cli": (
        "bench",
        "calibration",
        "conform",
        "console",
        "demo",
        "diagnosis",
        "doctor",
        "emulated",
        "experiments",
        "extras",
        "faults",
        "figures",
        "files",
        "fleet",
        "identification",
        "imaging",
        "machine",
        "observing",
        "pages",
        "processes",
        "receiving",
        "reconstruction",
        "recording",
        "reports",
        "shaping",
        "simulation",
        "verbs",
        "terminal",
        "version",
    ),
    "__main__": ("cli",),
}
"""What a room of `hil` may import beside itself and `errors`; each stands on rooms above it in this table."""


def files_of(root: Path) -> dict[str, Path]:
    """Every module of the four packages by its dotted name."""
    found = {}
    for floor in FLOORS:
        for path in sorted((root / floor).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def graph_of(root: Path) -> dict[str, set[str]]:
    """Which module imports which: in functions and under TYPE_CHECKING too."""
    files = files_of(root)
    graph: dict[str, set[str]] = {}
    for name, path in files.items():
        wanted = set()
        for _, module in imports_of(path, root):
            while module and module not in files:  # `from a.b import c` names a.b.c, where c may be no module
                module = module.rpartition(".")[0]
            wanted.add(module)
        graph[name] = wanted - {name, ""}
    return graph


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other, directly or through others (Tarjan 1972)."""
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    open_: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        number[node] = lowest[node] = len(number)
        open_.append(node)
        for other in sorted(graph[node]):
            if other not in number:
                visit(other)
            if other in open_:
                lowest[node] = min(lowest[node], lowest[other])
        if lowest[node] == number[node]:
            group = open_[open_.index(node) :]
            del open_[-len(group) :]
            if len(group) > 1:
                found.append(sorted(group))

    before = sys.getrecursionlimit()
    sys.setrecursionlimit(max(before, 4 * len(graph) + 1000))
    try:
        for node in graph:
            if node not in number:
                visit(node)
    finally:
        sys.setrecursionlimit(before)
    return found


def folders_of(root: Path) -> dict[str, set[str]]:
    """Which folder imports which, as `graph_of`.

    A folder is whatever stands in it. Where it holds further folders, each of its own files counts beside them: what is built on the
    folders and what they are built on may both stand there, a circle through one of them may not.
    """
    files = files_of(root)
    holders = {folder for path in files.values() for folder in path.parent.parents}

    def folder(module: str) -> str:
        path = files[module]
        return (path if path.parent in holders else path.parent).relative_to(root).as_posix()

    graph: dict[str, set[str]] = {folder(module): set() for module in files}
    for module, others in graph_of(root).items():
        graph[folder(module)] |= {folder(other) for other in others} - {folder(module)}
    return graph


def room_of(module: str) -> str:
    """The room of a module of `hil`, "" for any other."""
    parts = module.split(".")
    return parts[1] if parts[0] == "hil" and len(parts) > 1 else ""


def trespasses(root: Path) -> list[str]:
    """Every import between rooms of `hil` that the table does not have, as `file:line imports module`."""
    wrong = []
    for name, path in files_of(root).items():
        room = room_of(name)
        if not room:
            continue
        for line, module in imports_of(path, root):
            other = room_of(module)
            if other and other not in (room, "errors", *ROOMS.get(room, ())):
                wrong.append(f"{path.relative_to(root)}:{line} imports {module}")
    return wrong


def house(root: Path, files: dict[str, str]) -> Path:
    """A small house with these files."""
    for name, text in {"hil/__init__.py": "", **files}.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        (path.parent / "__init__.py").touch()
        path.write_text(text)
    return root


def test_no_files_import_each_other_in_a_circle() -> None:
    assert circles(graph_of(ROOT)) == []


def test_no_folders_import_each_other_in_a_circle() -> None:
    assert circles(folders_of(ROOT)) == []


def test_every_room_knows_only_rooms_that_it_may() -> None:
    assert trespasses(ROOT) == []


def test_every_room_has_a_row_and_stands_on_rooms_above_it() -> None:
    rooms = {path.name for path in (ROOT / "hil").iterdir() if path.is_dir() and list(path.glob("*.py"))}
    loose = {path.stem for path in (ROOT / "hil").glob("*.py")} - {"__init__"}
    assert rooms | loose == set(ROOMS)
    order = list(ROOMS)
    assert [(room, other) for room, others in ROOMS.items() for other in others if order.index(other) >= order.index(room)] == []


def test_the_architecture_page_names_every_room() -> None:
    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text(encoding="utf-8")
    rooms = {path.parent.name for floor in FLOORS for path in (ROOT / floor).glob("*/__init__.py")}
    assert sorted(room for room in rooms if f"`{room}/`" not in page) == []


@pytest.mark.parametrize(
    "late",
    ["from hil.b import g\n", "def f():\n    from hil.b import g\n", "if TYPE_CHECKING:\n    import hil.b\n", "from hil import b\n"],
)
def test_a_circle_is_found(tmp_path: Path, late: str) -> None:
    root = house(tmp_path, {"hil/a.py": late, "hil/b.py": "from hil.c import h\n", "hil/c.py": "import hil.a\n"})
    assert circles(graph_of(root)) == [["hil.a", "hil.b", "hil.c"]]


def test_a_package_that_imports_a_file_which_imports_it_is_a_circle(tmp_path: Path) -> None:
    root = house(tmp_path, {"hil/room/inner.py": "from hil.room import public\n"})
    (root / "hil/room/__init__.py").write_text("from hil.room.inner import public\n")
    assert circles(graph_of(root)) == [["hil.room", "hil.room.inner"]]


@pytest.mark.parametrize(
    ("back", "found"),
    [
        ("from hil.room.above import f\n", ["hil/room/above.py", "hil/room/inner"]),  # a parent's own file
        ("def f():\n    from hil.other.file import g\n", ["hil/other", "hil/room/inner"]),  # by way of another file of the other folder
        ("from hil.room.below import f\n", []),
    ],
)
def test_a_circle_of_folders_is_found_though_no_files_make_one(tmp_path: Path, back: str, found: list[str]) -> None:
    files = {
        "hil/room/above.py": "import hil.room.inner.first\n",
        "hil/room/below.py": "",
        "hil/room/inner/first.py": "",
        "hil/room/inner/second.py": back,
        "hil/other/file.py": "",
        "hil/other/more.py": "if TYPE_CHECKING:\n    from hil.room.inner import first\n",
    }
    root = house(tmp_path, files)
    assert circles(graph_of(root)) == []
    assert circles(folders_of(root)) == ([found] if found else [])


def test_a_trespass_is_found(tmp_path: Path) -> None:
    root = house(tmp_path, {"hil/machine/load.py": "def late():\n    from hil.bench.open import open_bench\n"})
    assert trespasses(root) == ["hil/machine/load.py:2 imports hil.bench.open.open_bench"]
