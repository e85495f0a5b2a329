"""Value networks: how much a state of vehicle and crowd is worth."""
