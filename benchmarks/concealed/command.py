"""The command line of the benchmark."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from concealed import directions, making, mutating, pairing, running, scoring, tables, trees
from hil.processes.workers import end_with_the_parent

RESULTS = Path(__file__).resolve().parents[1] / "results" / "concealed"


def main(arguments: list[str]) -> int:
    """Run one step or all of them."""
    parser = argparse.ArgumentParser(prog="python benchmarks/concealed", description=making.__doc__)
    parser.add_argument("step", choices=("make", "run", "score", "all", "mutate", "directions", "tables", "compare"))
    parser.add_argument("--seeds", choices=("development", "sealed"), default="development")
    parser.add_argument("--cases", type=_ranges, help="numbers, as in 0-39 or 3,5,8; all of the set by default")
    parser.add_argument("--strata", type=_strata, help="null, single, pair, off; comma between them; all by default")
    parser.add_argument("--jobs", type=int, default=2, help="processes at once")
    parser.add_argument("--scheduler", help="run, mutate, directions: a Dask scheduler, or `local`, in place of processes")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "isocenter-concealed", help="folder of the cases")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the results")
    parser.add_argument("--keep", action="store_true", help="keep recordings and reports of the cases that were run")
    parser.add_argument("--partial", action="store_true", help="score although cases have no answer, or several commits gave the answers")
    parser.add_argument(
        "--judged", type=Path, help="a file of scores: its cases are taken as they were judged there, with their own truths"
    )
    parser.add_argument("--scores", type=Path, help="tables: the file of scores to print")
    parser.add_argument("--trees", type=_commits, help="compare: two commits, comma between them")
    parser.add_argument("--carm", type=int, help="compare: so many cases of the C-arm, drawn by lot; all by default")
    options = parser.parse_args(arguments)
    if options.step == "tables":
        print(tables.tables_of(options.scores or options.results / f"scores_{options.seeds}.json"))
        return 0
    places = making.Places(options.work, options.seeds)
    options.results.mkdir(parents=True, exist_ok=True)
    if options.step == "compare":
        if options.trees is None:
            parser.error("compare: --trees names two commits, as in --trees HEAD~1,HEAD")
        _compare(places, options)
        return 0
    if options.step != "score":
        making.export_models(places)
    numbers = _numbers(options)
    if options.step == "make":
        _each(partial(making.make, places), numbers, options.jobs, "make", lambda _number, _row: None)
    if options.step in ("run", "all"):
        path = options.results / f"answers_{options.seeds}.jsonl"
        _append(path, numbers, partial(running.run_case, places, keep=options.keep), options)
    if options.step == "mutate":
        _append(options.results / f"mutations_{options.seeds}.jsonl", numbers, partial(mutating.mutate_case, places), options)
    if options.step == "directions":
        path = options.results / f"directions_{options.seeds}.jsonl"
        _append(path, numbers, partial(directions.directions_of, places), options)
        print(directions.said_of([json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]))
    if options.step in ("score", "all"):
        print(scoring.score(places, options.results, numbers, partial=options.partial, judged_before=options.judged))
    return 0


def _compare(places: making.Places, options: argparse.Namespace) -> None:
    """Let both commits answer what they have not answered yet, and print how they compare."""
    making.export_models(places)
    for commit in options.trees:
        trees.built(commit, places.work)
    answered = {commit: frozenset(trees.answers(options.results, commit)) for commit in options.trees}
    numbers = trees.order(places, _numbers(options), options.carm)
    left = [number for number in numbers if any(number not in done for done in answered.values())]

    def keep(_number: int, rows: list[dict[str, Any]]) -> None:
        for row in rows:
            for path, kept in (
                (trees.kept(options.results, row["commit"]), trees.in_short(row)),
                (trees.kept(places.work, row["commit"]), row),
            ):
                with path.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(kept, separators=(",", ":")) + "\n")

    _each(partial(trees.answer, places, options.trees, answered), left, options.jobs, "compare", keep)
    print(pairing.write(options.results, options.trees))


def _commits(text: str) -> tuple[str, ...]:
    """Two commits by their full names."""
    names = text.split(",")
    if len(names) != 2:
        raise argparse.ArgumentTypeError(f"{text!r}: two commits are right, as in HEAD~1,HEAD")
    return tuple(map(trees.commit_of, names))


def _numbers(options: argparse.Namespace) -> list[int]:
    """The cases asked for, in the order they were named."""
    numbers = options.cases if options.cases is not None else list(range(making.seeds(options.seeds)[1]))
    return [number for number in numbers if options.strata is None or making.stratum_of(number) in options.strata]


def _ranges(text: str) -> list[int]:
    """0-3,8 is 0, 1, 2, 3, 8."""
    numbers: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        try:
            numbers += range(int(first), int(last or first) + 1)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{part!r} is no case number or range; 0-39 or 3,5,8 is right") from None
    return numbers


def _strata(text: str) -> set[str]:
    """Names of strata."""
    names = set(text.split(","))
    if unknown := names - set(making.ORDER):
        raise argparse.ArgumentTypeError(f"no stratum {sorted(unknown)}; there are {sorted(set(making.ORDER))}")
    return names


def _append(path: Path, numbers: list[int], task: partial[Any], options: argparse.Namespace) -> None:
    """Do a task for the numbers that have no line yet, and add a line of JSON each."""
    done = {json.loads(line)["number"] for line in path.read_text().splitlines()} if path.exists() else set()
    with path.open("a", encoding="utf-8") as stream:

        def keep(_number: int, row: dict[str, Any]) -> None:
            stream.write(json.dumps(row) + "\n")
            stream.flush()

        left = [number for number in numbers if number not in done]
        if options.scheduler is None:
            _each(task, left, options.jobs, path.stem, keep)
        else:
            from concealed.on_cluster import each_on_cluster  # needs the extra `fleet`

            each_on_cluster(task, left, options.scheduler, options.jobs, keep, partial(print, flush=True))


def _each(task: Callable[[int], Any], numbers: Iterable[int], jobs: int, what: str, then: Callable[[int, Any], None]) -> None:
    """Do a task for every number, in their order, some at once; a case that fails is said and the others go on."""
    numbers = list(numbers)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    context = multiprocessing.get_context("spawn")
    with Progress(*columns) as progress, ProcessPoolExecutor(jobs, context, end_with_the_parent) as pool:
        bar = progress.add_task(what, total=len(numbers))
        waiting = {pool.submit(task, number): number for number in numbers}
        for future in as_completed(waiting):
            number = waiting[future]
            problem = future.exception()
            if problem is None:
                then(number, future.result())
            else:
                progress.console.print(f"case {number}: {type(problem).__name__}: {problem}")
            progress.advance(bar)
            if not progress.console.is_terminal:
                print(f"{what}: case {number}, {sum(done.done() for done in waiting)} of {len(numbers)}", flush=True)
