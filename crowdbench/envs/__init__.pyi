from .registration import VEHICLE as VEHICLE
from .rewards import Reward as Reward
from .rewards import load_reward as load_reward
from .stable_baselines import CrowdVecEnv as CrowdVecEnv
from .stepping import as_scenario as as_scenario
from .stepping import check_actions as check_actions
from .training_worlds import CASES as CASES
from .training_worlds import TrainingWorlds as TrainingWorlds
