"""Networks, their inputs, and their weights on disk."""
