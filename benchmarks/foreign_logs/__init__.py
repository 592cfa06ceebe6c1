"""Logs and recordings that other tools write: made here with known content, converted, and compared with what was put in."""
