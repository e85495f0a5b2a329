"""Networks that others have trained and published, in their own scenes and in the earlier suite."""
