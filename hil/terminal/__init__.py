"""What a person at a terminal sees: answers, progress, JSON beside them."""
