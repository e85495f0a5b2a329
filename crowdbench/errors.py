"""The one error that is meant for the user."""


class InputError(ValueError):
    """Something the user gave is wrong. The message is one sentence: what, where, and what would be right."""
