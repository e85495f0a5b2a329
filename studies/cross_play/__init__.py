"""Cross-play: scores of vehicles in crowds that they know and among strangers, and training of both together."""
