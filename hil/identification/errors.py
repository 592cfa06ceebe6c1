"""What can be wrong with data or settings handed to an identification method."""

from hil.errors import UnusableInputError


class IdentificationError(UnusableInputError):
    """The data or the settings do not allow the estimate that was asked for.

    Raised for, e.g., an input that is not excited, records whose periods do not match, or a local model with more unknowns than lines.
    """
