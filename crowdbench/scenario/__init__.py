"""Scenarios: their cases, the random draw of each case, and the TOML files that define them."""
