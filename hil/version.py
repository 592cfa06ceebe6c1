"""Which version of Isocenter this is."""

from __future__ import annotations


def software_version() -> str:
    """Return name and version, the name alone where nothing is installed."""
    from importlib.metadata import PackageNotFoundError, version  # slow to import, and few commands ask

    try:
        return f"isocenter {version('isocenter')}"
    except PackageNotFoundError:
        return "isocenter"
