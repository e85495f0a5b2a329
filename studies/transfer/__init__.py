"""True if a ranking of planners holds in other worlds."""
