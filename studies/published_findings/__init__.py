"""Findings of other papers as checks."""
