"""The simulator as PettingZoo and Gymnasium environments: thin views of it, not simulators of their own."""
