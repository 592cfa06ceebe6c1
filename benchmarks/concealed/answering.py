"""A server of one tree's command: started in a checkout of any commit, it imports that tree's diagnosis once and forks a process a command.

    PYTHONPATH=TREE python -P answering.py

Each line of standard input is a JSON list of the command's arguments, or an object with `arguments` and `limit_s`; each line of standard
output says how the command ended: `exit_status` (None beyond the limit), `said` (the end of its standard error), `wall_s`, `processor_s`.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

MODULES = ("hil.cli.register", "hil.cli.diagnose", "hil.diagnosis.diagnose", "hil.diagnosis.files")
"""What a diagnosis imports, in the trees that have it by this name."""

SAID_MOST = 500
"""Characters of standard error that are kept."""


def main() -> None:
    """Serve until standard input ends."""
    tree = Path(os.environ["PYTHONPATH"]).resolve()
    import hil

    if Path(hil.__file__).resolve().parents[1] != tree:
        sys.exit(f"{hil.__file__} is not of {tree}")
    for module in MODULES:
        try:
            importlib.import_module(module)
        except ModuleNotFoundError as error:
            if not (error.name or "").startswith("hil"):
                raise
    print(json.dumps({"ready": str(tree)}), flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        print(json.dumps(answer([str(each) for each in asked["arguments"]], float(asked["limit_s"]))), flush=True)


def answer(arguments: list[str], limit_s: float) -> dict[str, object]:
    """Run one command in a fork of this process."""
    with tempfile.TemporaryDirectory() as folder:
        said = Path(folder) / "said"
        begun = time.monotonic()
        child = os.fork()
        if child == 0:
            command(arguments, said)
        os.setpgid(child, child)
        status, usage, late = None, None, False
        while usage is None:
            done, code, used = os.wait4(child, os.WNOHANG)
            if done:
                status, usage = os.waitstatus_to_exitcode(code), used
            elif time.monotonic() - begun > limit_s and not late:
                os.killpg(child, signal.SIGKILL)
                late = True
            else:
                time.sleep(0.02)
        text = said.read_text(encoding="utf-8", errors="replace").strip() if said.exists() else ""
    return {
        "exit_status": None if late else status,
        "said": text[-SAID_MOST:],
        "wall_s": round(time.monotonic() - begun, 1),
        "processor_s": round(usage.ru_utime + usage.ru_stime, 1),
        "memory_MB": round(usage.ru_maxrss / 1024.0),
    }


def command(arguments: list[str], said: Path) -> None:
    """The child: standard output away, standard error kept. Never returns."""
    for path, stream in ((os.devnull, 0), (os.devnull, 1), (str(said), 2)):
        opened = os.open(path, os.O_RDONLY if stream == 0 else os.O_WRONLY | os.O_CREAT, 0o600)
        os.dup2(opened, stream)
    status = 70
    try:
        from hil.cli import main as isocenter

        sys.argv = ["isocenter", *arguments]
        result = isocenter(arguments)
        status = result if isinstance(result, int) else 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException as error:  # whatever ends the tool is its answer
        os.write(2, f"{type(error).__name__}: {error}".encode())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    main()
