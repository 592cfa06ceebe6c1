"""The shell completes commands, options and the names of shipped machines, as `isocenter --install-completion` sets it up."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

SHELL = "import sys; from hil.cli import main; sys.argv[0] = 'isocenter'; main()"


def completed(words: str) -> list[str]:
    """What bash is offered at the end of a line."""
    asked = {"_ISOCENTER_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split(" ")) - 1)}
    done = subprocess.run([sys.executable, "-c", SHELL], env=os.environ | asked, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("isocenter iden", ["identify"]),
        ("isocenter machine sch", ["schema"]),
        ("isocenter run scan --ax", ["--axis"]),
        ("isocenter machine check ca", ["carm", "carm-csp", "carm-csv", "carm-real"]),
        ("isocenter run jog -m turn", ["turntable"]),
        ("isocenter machine check ./mi", []),  # the shell completes paths by itself
    ],
)
def test_words_are_completed(words: str, offered: list[str]) -> None:
    assert completed(words) == offered


def test_every_command_is_offered() -> None:
    offered = completed("isocenter ")
    assert {"demo", "machine", "run", "diagnose", "foxglove"} <= set(offered)
    assert len(offered) > 20


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_gets_a_script(shell: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SHELL],
        env=os.environ | {"_ISOCENTER_COMPLETE": f"source_{shell}"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "isocenter" in done.stdout
    assert f"complete_{shell}" in done.stdout
