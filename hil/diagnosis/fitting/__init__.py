"""Effects screened by their responses and fitted together with the numbers of the machine file."""
