"""Errors of a control design: inputs from which no controller, excitation or trajectory can be made."""


class ControlError(Exception):
    """Base of every error the controllers raise on purpose."""

    exit_status = 2


class DesignError(ControlError, ValueError):
    """A section, excitation, jog or trajectory that cannot be designed as asked; the message says what would be right."""
