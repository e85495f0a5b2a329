"""Policies: networks that map what the vehicle sees to a command, without a lookahead."""
