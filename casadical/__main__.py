"""The command line as `python -m casadical`."""

from casadical.cli import main

main()
