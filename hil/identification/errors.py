"""Errors in the data or settings given to an identification method."""

from hil.errors import UnusableInputError


class IdentificationError(UnusableInputError):
    """Data or settings that do not allow the requested estimate.

    Raised, for example, for an input that is not excited, records whose periods do not match, or a local model with more unknowns than
    lines.
    """
