"""Output for a person at a terminal: answers, progress, JSON beside them."""
