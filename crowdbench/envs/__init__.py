"""The simulator as PettingZoo and Gymnasium environments: thin views of it, not simulators of their own.

Importing this package registers `crowdbench/Vehicle-v0` with Gymnasium, so that both of these work:

    import crowdbench.envs; gymnasium.make("crowdbench/Vehicle-v0")
    gymnasium.make("crowdbench.envs:crowdbench/Vehicle-v0")
"""

from crowdbench.envs import registration

registration.register()
