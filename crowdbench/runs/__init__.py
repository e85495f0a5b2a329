"""Runs: drive a planner through cases, measure and store the episodes, and compare and replay stored runs."""
