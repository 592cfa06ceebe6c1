"""The site: `sphinx-build -W --keep-going -b html docs build/site`, from the top folder of the checkout."""

from __future__ import annotations

import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

project = "Isocenter"
author = "The Isocenter authors"
version = release = installed_version("isocenter")

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
exclude_patterns = ["changes", "figures", "generate", "_static", "**/__pycache__"]

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
numpydoc_show_class_members = False

html_theme = "furo"
html_title = f"Isocenter {release}"
html_static_path = ["_static"]
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
html_show_sphinx = False

OWN = ("hil", "drivers", "controllers", "virtual_bus")

_SECTION = re.compile(r"^-{3,}$")
_CODE = re.compile(r"``?([^`]+)``?")


def _as_rst(text: str) -> str:
    """Write a line of a docstring as reStructuredText: code in single backticks stays code, and nothing else is markup."""
    parts = _CODE.split(text)
    plain = (re.sub(r"([*|\\`]|_(?=\W|$))", r"\\\1", part) for part in parts[::2])
    return "".join(part for pair in zip(plain, [*(f"``{each}``" for each in parts[1::2]), ""], strict=True) for part in pair)


def docstring_as_rst(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Prepare a docstring before numpydoc reads its sections; indented paragraphs of its text become blocks of code.

    Lines of an example stay as they are, up to the empty line that ends it.

    Sphinx reads the docstrings of imported members, too, before it leaves those members out: other packages' are not ours to prepare.
    """
    if getattr(obj, "__module__", None) and obj.__module__.partition(".")[0] not in OWN:
        return
    section = next((number - 1 for number, line in enumerate(lines) if _SECTION.match(line.strip())), len(lines))
    written: list[str] = []
    in_block = in_example = False
    for number, line in enumerate(lines):
        is_indented = number < section and line.startswith("  ")
        if is_indented and not in_block:
            written += ["", "::", ""]
            in_block = True
        elif line.strip() and not is_indented and in_block:
            written.append("")
            in_block = False
        is_rule = bool(_SECTION.match(line.strip()))
        in_example = bool(line.strip()) and (in_example or line.lstrip().startswith(">>> "))
        written.append(line if in_block or in_example or is_rule or line.startswith(".. ") else _as_rst(line))
    lines[:] = written


def setup(app: Sphinx) -> None:
    """Register what this site adds; numpydoc comes after."""
    app.connect("autodoc-process-docstring", docstring_as_rst, priority=100)
