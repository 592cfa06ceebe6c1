"""The page of examples, from `docs/examples`."""

from __future__ import annotations

import ast
import json
from pathlib import Path

from docs.generate.markdown import block, code, table
from docs.generate.markdown import page as whole

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"

INTRODUCTION = """
Ten tasks from Python, each a script or a notebook of `docs/examples` that runs by itself in an empty folder: on the emulated
machine, in lockstep, in seconds. On a real machine only `bus` changes. Their functions are described in the [Python
API](../api/front-door.md).
"""


def page() -> str:
    """Write the page."""
    parts = [_script(path) if path.suffix == ".py" else _notebook(path) for path in sorted(EXAMPLES.iterdir()) if _is_example(path)]
    rows = [[f"[{title}](#{title.lower().replace(' ', '-')})", said, code(name)] for name, title, said, _ in parts]
    sections = [f"## {title}\n\n{said}\n\n{body}" for _, title, said, body in parts]
    return whole("Examples", INTRODUCTION, table(["task", "what it shows", "file"], rows), *sections)


def _is_example(path: Path) -> bool:
    return path.suffix in (".py", ".ipynb")


def _script(path: Path) -> tuple[str, str, str, str]:
    """Return name, title, first sentence and body of a script."""
    text = path.read_text(encoding="utf-8")
    said = ast.get_docstring(ast.parse(text)) or ""
    body = text.split('"""', 2)[2]
    return path.name, path.stem.replace("_", " ").capitalize(), said, block(body, "python")


def _notebook(path: Path) -> tuple[str, str, str, str]:
    """Return name, title, first paragraph and body of a notebook."""
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]]
    title, said = cells[0][1].removeprefix("# ").split("\n\n", 1)
    body = [block(source, "python") if kind == "code" else source for kind, source in cells[1:]]
    return path.name, title, said, "\n\n".join(body)
