"""What a reader of recordings has to say without refusing."""


class RecordingWarning(UserWarning):
    """A recording that can be used, but not quite as it stands: it was cut short, or its time stamps were not believed."""
