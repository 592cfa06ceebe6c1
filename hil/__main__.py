"""`python -m hil` is `isocenter`."""

from hil.cli import main

main()
