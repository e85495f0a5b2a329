"""True if a ranking of planners depends on the reaction of people to the vehicle."""
