"""Expressions written out as Python source for numba: one assignment per value that is used more than once."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator

from virtual_bus.plant.symbols import Node

ENTRY = re.compile(r"\b([a-z])\[(\d+)\]")
SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}


class Emitter:
    """Writes the functions of one plant.

    What depends on parameters only is computed once, by the function of `derive_text`, and read from `c[k]` elsewhere.
    """

    def __init__(self) -> None:
        self._constants: dict[int, int] = {}  # node number -> slot of c
        self._constant_nodes: list[Node] = []

    @property
    def constant_count(self) -> int:
        """How many entries of `c` the functions written so far read."""
        return len(self._constant_nodes)

    def _slot(self, node: Node) -> str:
        if node.number not in self._constants:
            self._constants[node.number] = len(self._constant_nodes)
            self._constant_nodes.append(node)
        return f"c[{self._constants[node.number]}]"

    def function_text(self, name: str, targets: list[tuple[str, Node]], preamble: str) -> str:
        """Return the source of a compiled function of `model` and `work` that stores each node in its target.

        A target is a pair such as `("work.bias[1]", node)`.
        """
        head, *lines = self._function(f"@compiled_inside\ndef {name}(model, work):\n    {preamble}", targets, hoist=True)
        return "\n".join([head, *_read_once(lines)]) + "\n"

    def derive_text(self) -> str:
        """Return the source of the function that fills `c` from the parameters `p`.

        Call it last: the other functions decide what is in `c`.
        """
        targets = [(f"c[{k}]", node) for k, node in enumerate(self._constant_nodes)]
        return "\n".join(self._function("from math import cos, sin\n\n\ndef derive(p, c):", targets, hoist=False)) + "\n"

    def _function(self, head: str, targets: list[tuple[str, Node]], hoist: bool) -> list[str]:
        uses: Counter[int] = Counter()
        order: list[Node] = []
        stack = [(node, False) for _, node in reversed(targets)]
        seen: set[int] = set()
        for _, node in targets:
            uses[node.number] += 1
        while stack:  # depth first without recursion: operands before results
            node, done = stack.pop()
            if done:
                order.append(node)
                continue
            if node.number in seen:
                continue
            seen.add(node.number)
            stack.append((node, True))
            if hoist and node.is_parametric:
                continue
            for operand in node.operands:
                uses[operand.number] += 1
                stack.append((operand, False))
        text: dict[int, str] = {}
        lines = [head]
        for node in order:
            expression = self._expression(node, text, hoist)
            is_leaf = node.operation in ("constant", "input") or (hoist and node.is_parametric)
            if uses[node.number] > 1 and not is_leaf:
                name = f"x{len(lines)}"  # by its place, so that equal equations are written equally
                lines.append(f"    {name} = {expression}")
                expression = name
            text[node.number] = expression
        return lines + ([f"    {target} = {text[node.number]}" for target, node in targets] or ["    pass"])

    def _expression(self, node: Node, text: dict[int, str], hoist: bool) -> str:
        if node.operation == "constant":
            return repr(node.value) if node.value >= 0.0 else f"({node.value!r})"
        if hoist and node.is_parametric:
            return self._slot(node)
        if node.operation == "input":
            return node.text
        operands = [text[operand.number] for operand in node.operands]
        if node.operation == "neg":
            return f"(-{operands[0]})"
        if node.operation in SIGNS:
            return f"({operands[0]} {SIGNS[node.operation]} {operands[1]})"
        return f"{node.operation}({operands[0]})"


def _read_once(lines: list[str]) -> Iterator[str]:
    """Yield these lines with entries of arrays read into variables just before their first use: numba compiles every reading anew.

    After a store they are read anew, as if it might have changed them: only so are sums taken in the same order as without variables.
    """
    seen: set[str] = set()
    for line in lines:
        for entry in ENTRY.finditer(line):
            if entry[0] not in seen:
                seen.add(entry[0])
                yield f"    {entry[1]}{entry[2]} = {entry[0]}"
        yield ENTRY.sub(r"\1\2", line)
        if line.startswith("    work."):
            seen.clear()
