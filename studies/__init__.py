"""Research with crowdbench, a folder per study. It runs from a clone; nothing in the package imports it."""
