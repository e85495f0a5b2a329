"""A network of CrowdNav++ (Liu et al. 2023) as a planner, from your own clone of its code and weights.

    git clone https://github.com/Shuijing725/CrowdNav_Prediction_AttnGraph
    crowdbench run --planner ./crowdnav_plus_planner.py --option clone=CrowdNav_Prediction_AttnGraph \\
        --scenario crowdnav_plus_20 --isolated

In a process of its own (`--isolated`), because its code has modules named `rl` and `arguments`, and takes whatever
`sys.modules` has under these names.
"""

import argparse
import importlib
import pickle
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import torch
from gymnasium.spaces import Box
from numpy._core.multiarray import scalar

from crowdbench.planners.crowdnav_plus import CrowdNavPlusPlanner

CHECKPOINTS = {"GST_predictor_non_rand": "41200.pt", "GST_predictor_rand": "41665.pt"}


class Settings(pickle.Unpickler):
    """Reads the predictor's settings, a pickled `argparse.Namespace`, and refuses everything else."""

    def find_class(self, module, name):
        """Only that class."""
        if (module, name) != ("argparse", "Namespace"):
            raise pickle.UnpicklingError(f"{module}.{name} is no setting")
        return argparse.Namespace


def planner(clone: str = "CrowdNav_Prediction_AttnGraph", model: str = "GST_predictor_non_rand"):
    """Make the planner.

    Args:
        clone: Your clone of CrowdNav++.
        model: One of its trained models: GST_predictor_non_rand (people alike) or GST_predictor_rand (at random).

    Returns:
        The planner.
    """
    root = Path(clone).resolve()
    # Its network needs nothing of gym, baselines and rvo2, which no longer install: only its environments do.
    environments = ModuleType("rl.networks.envs")
    environments.VecNormalize = None
    sys.modules["rl.networks.envs"] = environments
    sys.path.insert(0, str(root))
    policy = importlib.import_module("rl.networks.model").Policy
    interface = importlib.import_module("gst_updated.scripts.wrapper.crowd_nav_interface_parallel")
    given, sys.argv = sys.argv, [""]  # its arguments are read from the command line
    try:
        arguments = importlib.import_module(f"trained_models.{model}.arguments").get_args()
        config = importlib.import_module(f"trained_models.{model}.configs.config").Config
    finally:
        sys.argv = given
    weights = root / "trained_models" / model / "checkpoints" / CHECKPOINTS[model]
    state = torch.load(weights, map_location="cpu", weights_only=True)
    # The environment says what a network is shown, and its saved arguments need not name the one of its training.
    is_shown_predictions = state["base.spatial_attn.embedding_layer.0.weight"].shape[1] > 2
    arguments.env_name = "CrowdSimPred-v0" if is_shown_predictions else "CrowdSimVarNum-v0"
    arguments.no_cuda, arguments.num_processes = True, 1
    people = config.sim.human_num + config.sim.human_num_range
    spaces = {"spatial_edges": SimpleNamespace(shape=(people, 2 * (config.sim.predict_steps + 1)))}
    network = policy(spaces, Box(-1.0, 1.0, (2,)), base=config.robot.policy, base_kwargs=arguments)
    network.load_state_dict(state)
    folder = root / config.pred.model_dir
    with (folder / "checkpoint" / "args.pickle").open("rb") as file:
        settings = Settings(file).load()
    # Beside the predictor's weights its file has losses, which are NumPy's numbers.
    kinds = [type(np.dtype(kind)) for kind in (np.float32, np.float64)]
    harmless = [(scalar, "numpy.core.multiarray.scalar"), np.dtype, *kinds]
    with torch.serialization.safe_globals(harmless):
        predictor = interface.CrowdNavPredInterfaceMultiEnv(str(folder), "cpu", settings, 1)
    return CrowdNavPlusPlanner(network, predictor)
