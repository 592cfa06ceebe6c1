"""What this process asks of the operating system: a real-time scheduler, helpers that end with it, memory that it keeps."""
