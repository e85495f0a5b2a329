"""Speed: how long steps, decisions, trainings and whole runs take on this machine."""
