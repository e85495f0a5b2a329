"""A planner in a process of its own: it is sent observations, sends back commands, and reaches nothing else.

The parent (`planner`) starts the process (`process`), in a sandbox where there is one (`sandbox`), and speaks with it
in a binary format (`protocol`). In the process, `client` constructs the planner and answers.
"""
