"""The local models of these methods: orders, bases, regression and least squares (thesis Secs. 3.4.2 and 4.3)."""
