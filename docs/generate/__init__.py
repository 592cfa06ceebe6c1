"""Generators of the reference pages: `python -m docs.generate` writes docs/generated, `--check` only compares."""
