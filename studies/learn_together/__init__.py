"""Training of vehicle and pedestrians with one shared network, and cross-play of vehicles and crowds."""
