"""Shapers for a machine: design goals, designs, their predicted performance, and shaped plans."""
