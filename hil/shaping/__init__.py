"""Shapers for a machine: what to design for, which design to take, what it promises, and the shaped plan."""
