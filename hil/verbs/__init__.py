"""What the bench can be asked for, a file a verb: `import hil` offers it, and commands show it (`hil.verbs.verb` says what a verb has)."""
