"""Runs the command line: `python -m crowdbench` is the same as `crowdbench`."""

from crowdbench.cli.app import main

main()
