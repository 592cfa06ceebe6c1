"""Which effects and numbers a machine needs: sets are proposed, fitted, and judged by what they were not fitted to."""
