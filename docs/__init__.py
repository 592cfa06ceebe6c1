"""Documentation: pages written by hand, generators of the others, and the site's configuration."""
