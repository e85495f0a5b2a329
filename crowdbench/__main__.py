"""Runs the command line: `python -m crowdbench` is the same as `crowdbench`."""

from crowdbench.cli import main

main()
