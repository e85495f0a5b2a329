"""The simulator: pedestrian policies and their kernels, motion, the rule of an episode, and the vehicle's sensor."""
