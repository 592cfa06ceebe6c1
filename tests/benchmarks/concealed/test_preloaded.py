"""A command in a process forked from one that has its modules is the command."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"  # from here: a process that imports this file is asked what it has

pytestmark = pytest.mark.skipif("forkserver" not in multiprocessing.get_all_start_methods(), reason="processes do not fork here")


ByItself = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def by_itself() -> ByItself:
    from concealed.making import COMMAND

    return lambda *arguments: subprocess.run([COMMAND, *arguments], capture_output=True, text=True, check=False)


def modules() -> list[str]:
    return list(sys.modules)


@pytest.mark.nightly
def test_it_writes_the_same_file_as_the_command_by_itself(tmp_path: Path, by_itself: ByItself) -> None:
    from concealed.preloaded import isocenter

    ours, its = tmp_path / "ours.xml", tmp_path / "its.xml"
    assert isocenter("machine", "export", "carm", "--mjcf", str(ours)).exit_status == 0
    assert by_itself("machine", "export", "carm", "--mjcf", str(its)).returncode == 0
    assert ours.read_bytes() == its.read_bytes()


@pytest.mark.nightly
def test_it_refuses_in_the_same_words(tmp_path: Path, by_itself: ByItself) -> None:
    from concealed.preloaded import isocenter

    asked = ("diagnose", "carm", str(tmp_path / "missing.csv"), "-o", str(tmp_path / "out"))
    done, other = isocenter(*asked), by_itself(*asked)
    assert (done.exit_status, done.said) == (other.returncode, other.stderr)
    assert done.exit_status == 2
    assert "missing.csv" in done.said


def test_what_takes_longer_than_its_limit_is_stopped_there(tmp_path: Path) -> None:
    from concealed.preloaded import isocenter

    out = tmp_path / "carm.xml"
    assert isocenter("machine", "export", "carm", "--mjcf", str(out), limit_s=0.0).exit_status is None
    assert not out.exists()


def test_it_begins_with_the_tool_and_without_the_truth() -> None:
    from concealed.preloaded import MODULES, context

    for name in MODULES:
        import_module(name)
    import_module("concealed.truth.build")
    with ProcessPoolExecutor(1, mp_context=context()) as pool:
        there = pool.submit(modules).result()
    assert set(MODULES) <= set(there)
    assert not [name for name in there if name.startswith(("concealed", "mujoco"))]


@pytest.mark.nightly
def test_a_worker_of_the_benchmark_can_run_it() -> None:
    from concealed.preloaded import isocenter

    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(isocenter, "effects").result().exit_status == 0


@pytest.mark.nightly
def test_another_checkout_s_tool_is_refused(tmp_path: Path) -> None:
    """Where the benchmark is begun in a folder with a `hil` of its own, that one would be loaded."""
    other = tmp_path / "hil"
    other.mkdir()
    (other / "__init__.py").touch()
    (other / "cli.py").write_text("def main(arguments): pass\n", encoding="utf-8")
    asked = f"import sys; sys.path.insert(0, {str(BENCHMARKS)!r}); from concealed.preloaded import isocenter; isocenter('effects')"
    done = subprocess.run([sys.executable, "-c", asked], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert f"{other / '__init__.py'} is not of" in done.stderr
