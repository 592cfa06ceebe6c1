"""The warning of readers of recordings."""


class RecordingWarning(UserWarning):
    """A recording that can be used with a restriction: it was cut short, or its time stamps were replaced."""
