"""Dependence of a ranking of planners on the reaction of pedestrians to the vehicle."""
