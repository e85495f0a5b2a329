"""Scenarios: which cases there are, how each is drawn, and the TOML files that say so."""
