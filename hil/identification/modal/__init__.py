"""Modal models over poses (thesis Sec. 5.4): one pose, all poses together, and their choice."""
