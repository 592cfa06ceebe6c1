"""What can go wrong in a control design: an input that no controller, excitation or trajectory can be made from."""


class ControlError(Exception):
    """Base of every error the controllers raise on purpose."""

    exit_status = 2


class DesignError(ControlError, ValueError):
    """A section, excitation, jog or trajectory that cannot be designed as asked; the message says what would be right."""
