"""Evaluation: drive a planner through cases, measure what happened, keep and compare results."""
