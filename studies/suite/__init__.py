"""The suite: levels of its scenarios, and the order of planners in both tracks of sensing."""
