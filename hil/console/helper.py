"""A process beside the server that plans experiments and reads recordings: what the server asks it, a question and an answer a line.

`python -m hil.console.helper MACHINE` answers JSON objects that it reads from standard input, until that ends. It stays between questions,
since to import and to compile takes most of an answer's time.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Mapping
from typing import Any

from hil.processes.second_in_line import POLITE, PROMPT, politely

IDLE_S = 120.0
"""Time without a question after which its memory is given back."""
LEFT_S = 5.0
"""Time that a question which nobody waits for any more may keep the next one waiting: about what another process takes to begin."""
MOST_BYTES = 1 << 28
"""Longest answer."""


class Helper:
    """The server's end: one question at a time; the process begins with the first.

    Parameters
    ----------
    machine : str
        As the command line takes it.
    """

    def __init__(self, machine: str) -> None:
        self._machine = machine
        self._process: asyncio.subprocess.Process | None = None
        self._one = asyncio.Lock()
        self._left: asyncio.Task[bytes] | None = None  # of whoever was cancelled: it is answered, and nobody hears it
        self._ends: asyncio.TimerHandle | None = None

    async def ask(self, question: Mapping[str, Any], longest_s: float) -> bytes:
        """Return the answer, a JSON object; the process outlives whoever is cancelled while it is sought.

        Raises
        ------
        TimeoutError
            It took longer than `longest_s`.
        ValueError
            The process has ended without an answer.
        """
        async with self._one:
            if self._ends is not None:
                self._ends.cancel()
            await self._come_to_rest()
            self._left = asyncio.create_task(self._answer(question))
            self._ends = asyncio.get_running_loop().call_later(max(IDLE_S, longest_s), self._end)
            await asyncio.wait([self._left], timeout=longest_s)
            sought, self._left = self._left, None
            answered = sought.done() and sought.exception() is None
            if not answered:
                await self._kill(sought)
            if not sought.done() or sought.cancelled():
                raise TimeoutError(f"no answer in {longest_s:g} s")
            return sought.result()

    async def close(self) -> None:
        """End the process."""
        if self._ends is not None:
            self._ends.cancel()
        await self._kill(self._left)

    async def _come_to_rest(self) -> None:
        """Wait for the answer that nobody hears, or end the process with it."""
        if self._left is not None:
            await asyncio.wait([self._left], timeout=LEFT_S)
            if not self._left.done() or self._left.exception() is not None:
                await self._kill(self._left)
            self._left = None

    async def _kill(self, sought: asyncio.Task[bytes] | None) -> None:
        if sought is not None:
            sought.cancel()
        process, self._process = self._process, None
        if process is not None and process.returncode is None:
            process.kill()
            await process.wait()

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None and process.returncode is None:
            process.kill()

    async def _answer(self, question: Mapping[str, Any]) -> bytes:
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "hil.console.helper", self._machine),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.DEVNULL,
                limit=MOST_BYTES,
            )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(question).encode() + b"\n")
            await self._process.stdin.drain()
        except OSError as error:
            raise ValueError(str(error)) from None
        answer = await self._process.stdout.readline()
        if not answer.endswith(b"\n"):
            raise ValueError("no answer")
        return answer


def answer(machine: str, question: Mapping[str, Any]) -> dict[str, Any]:
    """Answer a question: `plan`, an experiment file's text, or `curves` of recordings."""
    if "plan" in question:
        from hil.console.preview import preview

        return preview(machine, str(question["plan"]))
    from hil.console.curves import curves

    return curves(machine, question["files"], question["channels"], str(question["align"]))


def _answer_all(machine: str) -> None:
    for line in sys.stdin:
        print(json.dumps(answer(machine, json.loads(line))), flush=True)


if __name__ == "__main__":
    politely(_answer_all, sys.argv[1], niceness=POLITE - PROMPT)  # the server has PROMPT already, and its STOP comes before
