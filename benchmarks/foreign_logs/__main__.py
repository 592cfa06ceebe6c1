"""Logs and recordings that other tools write, converted by the command and compared with what was put in.

Each file is made in a temporary folder and converted to CSV with `isocenter convert`; the CSV is read with NumPy alone. A file is right
when times and values are those that went in, what could not be taken is listed, or, where it cannot be read, the one line says what to do.
Files that are right in OUT already are passed over, so it goes on where it was stopped.

    python benchmarks/foreign_logs
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from foreign_logs import can_files, matlab, signals, tables
from foreign_logs.known import Foreign

RESULTS = Path(__file__).resolve().parents[1] / "results" / "foreign_logs.json"
FILES = {one.name: one for one in (*can_files.FILES, *signals.FILES, *matlab.FILES, *tables.FILES)}
assert len(FILES) == sum(len(part.FILES) for part in (can_files, signals, matlab, tables)), "names are unique"


def judged(foreign: Foreign, keep: Path | None) -> dict[str, Any]:
    """Make a file, convert it, and return what was wrong: an empty text if nothing."""
    about = {"kind": foreign.kind, "tool": foreign.tool}
    with tempfile.TemporaryDirectory(prefix="foreign-logs-") as name:
        folder = keep / foreign.name if keep else Path(name)
        folder.mkdir(exist_ok=True, parents=True)
        try:
            path = foreign.make(folder)
        except (ModuleNotFoundError, FileNotFoundError) as problem:
            return about | {"right": None, "why": f"not made: {problem}"}
        except (subprocess.CalledProcessError, Exception) as problem:
            said = getattr(problem, "stderr", b"") or b""
            return about | {"right": None, "why": f"not made: {problem!r} {said.decode()[-300:]}"}
        out = folder / "out"
        out.mkdir(exist_ok=True)
        command = [sys.executable, "-m", "hil", "convert", str(path), str(out / "out.csv"), "--machine", "carm", "--json", "-"]
        command += [word for entry in foreign.maps for word in ("--map", entry)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
        said = done.stderr.strip()
        if foreign.refused:
            right = done.returncode == 2 and foreign.refused in said and said.count("\n") == 0
            return about | {"right": right, "refused": right, "why": "" if right else said or "was read"}
        if done.returncode:
            return about | {"right": False, "why": said.replace(str(folder), "")[-400:]}
        why = differences(foreign, out / "out.csv", json.loads(done.stdout), said)
        answer = json.loads(done.stdout)
        return about | {
            "right": not why,
            "why": why,
            "rows": answer["rows"],
            "not_taken": len(answer["not_taken"]),
            "notes": answer["notes"],
        }


def differences(foreign: Foreign, path: Path, answer: dict[str, Any], said: str) -> str:
    """Return in what the converted file differs from what was put in."""
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    columns = {cell.partition(" [")[0]: np.array([float(row[k] or "nan") for row in rows]) for k, cell in enumerate(header)}
    time_s = columns["time"] - columns["time"][0]
    if len(time_s) != len(foreign.time_s):
        return f"{len(time_s)} rows of {len(foreign.time_s)}"
    if np.abs(time_s - foreign.time_s).max() > foreign.time_within_s:
        return f"time is off by {np.abs(time_s - foreign.time_s).max():.3g} s"
    for name, known in foreign.known.items():
        if name not in columns:
            return f"no channel {name}, but {', '.join(columns)}"
        values = columns[name]
        if np.any(np.isnan(values) != np.isnan(known.values)):
            return f"{name}: {np.isnan(values).sum()} missing samples of {np.isnan(known.values).sum()}"
        if (off := np.nanmax(np.abs(values - known.values))) > known.within:
            return f"{name}: off by {off:.3g}"
    for what, words in (("not_taken", foreign.left), ("notes", foreign.noted)):
        for word in words:
            if not any(word in entry for entry in answer[what]):
                return f"{what} lacks {word!r}: {answer[what]}"
            if word not in said:
                return f"{word!r} was not said: {said}"
    return ""


def version(tool: str) -> str:
    """Return the version of a tool that is a package; '' of others."""
    names = {"Foxglove SDK": "foxglove-sdk"}
    try:
        return metadata.version(names.get(tool, tool))
    except metadata.PackageNotFoundError:
        return ""


def document(found: dict[str, Any]) -> dict[str, Any]:
    """Return the results with sums by kind."""
    found = {name: found[name] for name in FILES if name in found}
    kinds: dict[str, Any] = {}
    for one in found.values():
        counts = kinds.setdefault(one["kind"], {"files": 0, "right": 0, "tools": []})
        counts["files"] += one["right"] is not None
        counts["right"] += one["right"] is True
        if one["right"] is not None and one["tool"] not in counts["tools"]:
            counts["tools"].append(one["tool"])
    for counts in kinds.values():
        counts["tools"] = ", ".join(counts["tools"])
    made = [one for one in found.values() if one["right"] is not None]
    total = {"made": len(made), "right": sum(one["right"] for one in made), "refused": sum(one.get("refused", False) for one in made)}
    total["not_made"] = len(FILES) - len(made)
    tools = {tool: version(tool) for tool in sorted({one["tool"] for one in made})}
    return {"total": total, "kinds": kinds, "tools": tools, "files": found}


def main() -> None:
    """Convert what is not right in OUT yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, default=RESULTS, metavar="OUT", help="results, read first")
    parser.add_argument("--only", default="", metavar="WORD", help="files with this in their name")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where the files stay")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="conversions at a time")
    arguments = parser.parse_args()
    found = json.loads(arguments.json.read_text())["files"] if arguments.json.exists() else {}
    waiting = [one for name, one in FILES.items() if arguments.only in name and not found.get(name, {}).get("right")]
    with ThreadPoolExecutor(arguments.jobs) as pool:
        for foreign, answer in zip(waiting, pool.map(lambda one: judged(one, arguments.keep), waiting), strict=True):
            found[foreign.name] = answer
            print(f"{foreign.name}: {'right' if answer['right'] else answer['why']}", flush=True)
            arguments.json.write_text(json.dumps(document(found), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(json.dumps(document(found)["total"]))


if __name__ == "__main__":
    main()
