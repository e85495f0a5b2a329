"""A run: a planner drives cases, what happened is measured and kept, and runs are compared and replayed."""
