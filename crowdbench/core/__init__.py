"""What everything stands on: the types of data, plane geometry, random streams, vehicle dynamics, the reward."""
