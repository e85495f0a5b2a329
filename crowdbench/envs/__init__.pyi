from .registration import VEHICLE as VEHICLE
from .rewards import Reward as Reward
from .rewards import load_reward as load_reward
from .training_worlds import CASES as CASES
from .training_worlds import TrainingWorlds as TrainingWorlds
