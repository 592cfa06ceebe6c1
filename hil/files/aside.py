"""An earlier recording moved aside, never written over."""

from __future__ import annotations

import itertools
from pathlib import Path


def keep_earlier(path: Path) -> str:
    """Move an existing recording aside, and say so; "" where there is none.

    A recording is never written over.
    """
    if not path.is_file():
        return ""
    aside = next(kept for n in itertools.count(1) if not (kept := path.with_name(f"{path.stem}.earlier{n}{path.suffix}")).exists())
    path.rename(aside)
    if path.with_suffix(".toml").exists() and path.suffix == ".csv":
        path.with_suffix(".toml").rename(aside.with_suffix(".toml"))
    if (events := path.with_suffix(".events.jsonl")).exists():
        events.rename(aside.with_suffix(".events.jsonl"))
    return f"{path} was there already; it is now {aside.name}"
