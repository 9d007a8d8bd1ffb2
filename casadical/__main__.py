"""Run the command line as `python -m casadical`."""

from casadical.cli import main

if __name__ == "__main__":
    main()
