"""The file that the how-to page writes is an effect that the registry takes."""

from __future__ import annotations

import re
import textwrap

from places import ROOT

from virtual_bus.effects.effect import Effect
from virtual_bus.effects.motion import JointState

PAGE = ROOT / "docs" / "how-to" / "add-an-effect.md"


def test_the_page_s_file_defines_what_the_registry_asks_for() -> None:
    text = PAGE.read_text(encoding="utf-8")
    block = next(block for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "EFFECT = " in block)
    module: dict[str, object] = {}
    exec(compile(textwrap.dedent(block), str(PAGE), "exec"), module)
    effect, level, laws = module["EFFECT"], module["level"], module["laws"]
    assert isinstance(effect, Effect)
    assert callable(level)
    assert callable(laws)
    assert level(JointState(2.0, 1.0, 0.0, 0.0), 3.0) == 24.0
    (law,) = laws(None)
    assert law.parameters([5.0]) == {effect.parameters[0].name: 5.0}
