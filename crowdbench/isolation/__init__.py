"""Planners in separate processes: they receive observations, return commands, and have access to nothing else.

The parent (`planner`) starts the process (`process`), in a sandbox if one is available (`sandbox`), and exchanges
messages with it in a binary format (`protocol`). In the process, `client` constructs the planner and answers messages.
"""
