"""Foundations: the types of data, plane geometry, random streams, vehicle dynamics, the reward."""
