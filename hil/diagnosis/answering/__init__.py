"""The answer's words and numbers: verdict, findings with intervals, what was re-tuned, what looks wrongly wired."""
