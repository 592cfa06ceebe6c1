"""Which version of Isocenter this is."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def software_version() -> str:
    """Return name and version, the name alone where nothing is installed."""
    try:
        return f"isocenter {version('isocenter')}"
    except PackageNotFoundError:
        return "isocenter"
