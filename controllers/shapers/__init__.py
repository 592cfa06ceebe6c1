"""Reference shapers of Chapter 7: delay filters that move a machine without leaving it vibrating."""
