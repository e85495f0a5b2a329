"""Certificates: commands by which the vehicle succeeds in a case, found with foresight of what people will do."""
