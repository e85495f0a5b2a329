"""Transfer of a ranking of planners to other worlds."""
