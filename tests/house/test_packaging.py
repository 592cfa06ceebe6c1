"""What a wheel must carry besides Python is declared to setuptools."""

from __future__ import annotations

import tomllib
from fnmatch import fnmatch
from pathlib import Path

from places import ROOT

SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_data_file_of_a_package_is_declared() -> None:
    declared = SETTINGS["tool"]["setuptools"]["package-data"]
    for package in ("hil", "drivers", "controllers", "virtual_bus"):
        for path in (ROOT / package).rglob("*"):
            if path.is_file() and path.suffix != ".py" and "__pycache__" not in path.parts:
                name = path.relative_to(ROOT / package).as_posix()
                patterns = [pattern.removeprefix("**/") for pattern in declared.get(package, [])]
                assert any(fnmatch(Path(name).name, pattern) for pattern in patterns), f"{package}/{name} is in no package-data pattern"


def test_every_folder_of_a_package_with_modules_is_a_package() -> None:
    for package in ("hil", "drivers", "controllers", "virtual_bus"):
        for path in (ROOT / package).rglob("*.py"):
            folder = path.parent
            assert (folder / "__init__.py").exists(), f"{folder.relative_to(ROOT)} holds modules and no __init__.py: a wheel would miss it"
