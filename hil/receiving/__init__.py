"""Images received while a run goes on: frames taken from the panel, looked at, written as a scan."""
