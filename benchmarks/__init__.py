"""Benchmarks of the time for steps, decisions, trainings and whole runs on this machine."""
