"""Where simulation and recording differ, which physics was left out, and how sure that is. See docs/explanation/diagnosis.md."""
