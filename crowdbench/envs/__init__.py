"""PettingZoo and Gymnasium environments: thin layers over the simulator that rollouts use too."""
