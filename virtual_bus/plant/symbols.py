"""Scalar expressions that remember how they were computed, so that a plant's equations can be written out once and compiled.

Equal expressions are one node (hash-consing), and 0 and 1 fold away, so the result has no common subexpressions and no work on structural
zeros.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Required, TypedDict, Unpack

Number = float | int


@dataclass(eq=False)
class Node:
    """One value: a constant, an input of the equations, or an operation on other nodes."""

    graph: Graph = field(repr=False)
    number: int  # order of creation: operands always come before their result
    operation: str  # "constant", "input", "neg", "add", "sub", "mul", "div", "sin", "cos"
    operands: tuple[Node, ...] = ()
    value: float = 0.0  # of a constant
    text: str = ""  # of an input, as it is written in the generated module
    is_parametric: bool = False  # depends on parameters only, not on the state

    def __neg__(self) -> Node:
        """Return minus this value."""
        return self.graph.neg(self)

    def __add__(self, other: Node | Number) -> Node:
        """Return the sum of this value and another."""
        return self.graph.add(self, self.graph.lift(other))

    def __radd__(self, other: Number) -> Node:
        """Return the sum of a number and this value."""
        return self.graph.add(self.graph.lift(other), self)

    def __sub__(self, other: Node | Number) -> Node:
        """Return this value less another."""
        return self.graph.sub(self, self.graph.lift(other))

    def __rsub__(self, other: Number) -> Node:
        """Return a number less this value."""
        return self.graph.sub(self.graph.lift(other), self)

    def __mul__(self, other: Node | Number) -> Node:
        """Return the product of this value and another."""
        return self.graph.mul(self, self.graph.lift(other))

    def __rmul__(self, other: Number) -> Node:
        """Return the product of a number and this value."""
        return self.graph.mul(self.graph.lift(other), self)

    def is_value(self, value: float) -> bool:
        """Return whether this is a constant of that value."""
        return self.operation == "constant" and self.value == value


class _Fields(TypedDict, total=False):
    """What a node is, besides its graph and its number."""

    operation: Required[str]
    operands: tuple[Node, ...]
    value: float
    text: str
    is_parametric: bool


class Graph:
    """The maker of the nodes of one set of equations, each expression once."""

    def __init__(self) -> None:
        self._nodes: dict[tuple[object, ...], Node] = {}
        self.zero = self.constant(0.0)
        self.one = self.constant(1.0)

    def _node(self, key: tuple[object, ...], **fields: Unpack[_Fields]) -> Node:
        if key not in self._nodes:
            self._nodes[key] = Node(self, len(self._nodes), **fields)
        return self._nodes[key]

    def constant(self, value: float) -> Node:
        """Return the node of a number."""
        value = float(value) + 0.0  # no negative zero
        return self._node(("constant", value), operation="constant", value=value, is_parametric=True)

    def input(self, text: str, is_parametric: bool = False) -> Node:
        """Return a value the generated function is given, as it is written there: `q[3]`, `p[12]`."""
        return self._node(("input", text), operation="input", text=text, is_parametric=is_parametric)

    def lift(self, value: Node | Number) -> Node:
        """Return a node as it is, and a number as a constant."""
        return value if isinstance(value, Node) else self.constant(value)

    def _operation(self, operation: str, *operands: Node) -> Node:
        return self._node(
            (operation, *(operand.number for operand in operands)),
            operation=operation,
            operands=operands,
            is_parametric=all(operand.is_parametric for operand in operands),
        )

    def neg(self, a: Node) -> Node:
        """Return −a, with the sign of a constant or a difference taken inside."""
        if a.operation == "constant":
            return self.constant(-a.value)
        if a.operation == "neg":
            return a.operands[0]
        if a.operation == "sub":
            return self.sub(a.operands[1], a.operands[0])
        return self._operation("neg", a)

    def add(self, a: Node, b: Node) -> Node:
        """Return a + b."""
        if a.operation == "constant" and b.operation == "constant":
            return self.constant(a.value + b.value)
        if a.is_value(0.0):
            return b
        if b.is_value(0.0):
            return a
        if b.operation == "neg":
            return self.sub(a, b.operands[0])
        if a.operation == "neg":
            return self.sub(b, a.operands[0])
        return self._operation("add", *sorted((a, b), key=lambda node: node.number))

    def sub(self, a: Node, b: Node) -> Node:
        """Return a − b."""
        if a is b:
            return self.zero
        if a.operation == "constant" and b.operation == "constant":
            return self.constant(a.value - b.value)
        if a.is_value(0.0):
            return self.neg(b)
        if b.is_value(0.0):
            return a
        if b.operation == "neg":
            return self.add(a, b.operands[0])
        if a.operation == "neg":
            return self.neg(self.add(a.operands[0], b))
        return self._operation("sub", a, b)

    def mul(self, a: Node, b: Node) -> Node:
        """Return a · b."""
        if a.operation == "constant" and b.operation == "constant":
            return self.constant(a.value * b.value)
        for one, other in ((a, b), (b, a)):
            if one.is_value(0.0):
                return self.zero
            if one.is_value(1.0):
                return other
            if one.is_value(-1.0):
                return self.neg(other)
            if one.operation == "neg":  # signs travel outwards, so that a·b and (−a)·b share one product
                return self.neg(self.mul(one.operands[0], other))
        return self._operation("mul", *sorted((a, b), key=lambda node: node.number))

    def div(self, a: Node, b: Node) -> Node:
        """Return a / b."""
        if b.is_value(1.0):
            return a
        if a.is_value(0.0):
            return self.zero
        return self._operation("div", a, b)

    def sin(self, a: Node) -> Node:
        """Return sin a."""
        return self.constant(math.sin(a.value)) if a.operation == "constant" else self._operation("sin", a)

    def cos(self, a: Node) -> Node:
        """Return cos a."""
        return self.constant(math.cos(a.value)) if a.operation == "constant" else self._operation("cos", a)
