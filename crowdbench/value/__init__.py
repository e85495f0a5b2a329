"""Value networks: the expected return of a state of the vehicle and the pedestrians around it."""
