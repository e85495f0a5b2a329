"""Studies: a TOML file of planners, scenarios and settings, the runs that it lists, and the table of these runs."""
