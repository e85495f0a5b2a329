"""crowdbench: the benchmark for navigation in crowds."""
