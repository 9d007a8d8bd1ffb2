"""The command line by `python -m casadical`."""

from casadical.cli import main

main()
