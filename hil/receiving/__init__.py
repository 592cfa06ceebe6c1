"""Images received during a run: frames taken from the panel, looked at, written as a scan."""
