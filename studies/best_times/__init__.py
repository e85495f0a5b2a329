"""Best known times: commands found with knowledge of the pedestrians' future, for validation cases of the suite."""
