"""`python -m crowdbench` is `crowdbench`."""

from crowdbench.cli import main

main()
