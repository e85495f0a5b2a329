"""Certificates: commands by which the vehicle succeeds in a case, found with knowledge of the pedestrians' future."""
