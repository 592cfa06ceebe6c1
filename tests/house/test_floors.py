"""A floor imports only from floors under it, and the emulated machine never meets the models that are fitted to its recordings."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from places import ROOT

FLOORS = ("hil", "virtual_bus", "controllers", "drivers")

WIRE_AGREEMENTS = (
    "drivers.canopen.can_imu",
    "drivers.canopen.eds",
    "drivers.canopen.objects",
    "drivers.canopen.units",
    "drivers.serial.xbus",
    "drivers.modbus.registers",
    "drivers.modbus.refresh",
)
"""What both ends of a wire must agree on: dictionaries, units, frame codecs. The emulated machine knows nothing else of `drivers`."""

MAY_IMPORT = {
    "hil": FLOORS,
    "virtual_bus": ("virtual_bus", *WIRE_AGREEMENTS),
    "controllers": ("controllers",),
    "drivers": ("drivers",),
}


def imports_of(path: Path, root: Path) -> list[tuple[int, str]]:
    """(line, dotted module) of every import in a file, relative ones resolved."""
    package = path.relative_to(root).with_suffix("").parts[:-1]
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            found += [(node.lineno, name.name) for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(part for part in (base, node.module or "") if part)
            found += [(node.lineno, f"{module}.{name.name}") for name in node.names]
    return found


def violations(root: Path) -> list[str]:
    """Every import that climbs, as `file:line imports module`."""
    wrong = []
    for floor in FLOORS:
        for path in sorted((root / floor).rglob("*.py")):
            for line, module in imports_of(path, root):
                if module.split(".")[0] not in FLOORS:
                    continue
                allowed = any(module == name or module.startswith(name + ".") for name in MAY_IMPORT[floor])
                if not allowed:
                    wrong.append(f"{path.relative_to(root)}:{line} imports {module}")
    return wrong


def test_every_import_stays_on_its_floor_or_goes_down() -> None:
    assert violations(ROOT) == []


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("controllers/observer.py", "from virtual_bus.plant import compile_plant\n"),
        ("drivers/imu.py", "import hil.bench.loop\n"),
        ("virtual_bus/node.py", "from drivers.machine_link import CanMachine\n"),
        ("virtual_bus/node.py", "def late():\n    from controllers import feedback\n"),
        ("controllers/models/modal.py", "from virtual_bus.physics import Physics\n"),
    ],
)
def test_a_climbing_import_is_found(tmp_path: Path, file: str, text: str) -> None:
    for floor in FLOORS:
        (tmp_path / floor).mkdir()
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(text)
    assert len(violations(tmp_path)) == 1


def test_a_wire_agreement_may_be_shared(tmp_path: Path) -> None:
    for floor in FLOORS:
        (tmp_path / floor).mkdir()
    (tmp_path / "virtual_bus/node.py").write_text("from drivers.canopen.eds import load_object_dictionary\n")
    assert violations(tmp_path) == []
