"""The simulator: kernels that move pedestrians, the policies around them, and the rules of an episode."""
