"""Requests to the operating system: a real-time scheduler, helper processes that end with this one, memory that it keeps."""
