"""Vehicle and pedestrians are one learner, and every vehicle drives in every crowd."""
