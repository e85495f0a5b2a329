"""Print the cross-play of vehicles and crowds that were trained together, or train them again."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, help_from_docstring, main, use_threads

HERE = Path(__file__).parent
WITH_ORCA, TOGETHER = HERE / "with_orca.onnx", HERE / "together.onnx"
SCENARIO = "circle_crossing_5_visible"
VIEW: dict[str, Any] = {"reward": "progress", "observation": "goal_frame", "action": "goal_frame", "nearest": 3}
VEHICLES = (str(WITH_ORCA), str(TOGETHER), "mppi", "sarl_cvm")
CROWDS = ("orca", "social_force", "learned")
METRICS = ("success_rate", "at_fault_rate", "navigation_time")
WORLDS = 16
WEIGHTS = HERE.parents[1] / "agents" / "pedestrians" / "learned" / "learned.npz"

DESCRIPTION = f"""# Learning together

One network drives the vehicle and all pedestrians: the vehicle `together`, and the pedestrian policy `learned`. It was
trained by PPO with shared parameters (IPPO, de Witt et al. 2020, [arXiv:2011.09533](https://arxiv.org/abs/2011.09533))
in the PettingZoo environment of `{SCENARIO}`, where everybody is paid for progress to the goal. The vehicle
`with_orca` has the same network and the same PPO, and was trained among ORCA pedestrians. Columns are crowds, rows are
vehicles. Pedestrians see the vehicle. The networks that ship were trained with one seed, `together` for 5 and
`with_orca` for 2 minutes of processor time; `--train MINUTES` trains both again."""


@help_from_docstring
def cross_play(
    train: Annotated[float | None, typer.Option(min=0.0)] = None,
    cases: str = "val:50",
    out: Path = Path("runs/study-learn_together"),
    threads: ThreadsOption = None,
) -> None:
    """Execute the missing runs of each vehicle in each crowd, and print the page of the study.

    Args:
        train: Train both networks first, for this many minutes of processor time each, and replace the shipped ones.
        cases: The cases of each run.
        out: Folder for the runs.
    """
    use_threads(threads)
    from crowdbench import Cases
    from crowdbench.results import RunTable
    from crowdbench.runs import RunSpec, load_run, run_directory
    from crowdbench.utils import markdown, printed_by
    from studies.command import make_runs

    if train is not None:
        train_both(train)
    drawn = Cases.parse(cases)
    specs = [RunSpec(v, SCENARIO, drawn, pedestrians=crowd, record="none") for v in VEHICLES for crowd in CROWDS]
    runs = list(map(load_run, specs))
    make_runs(runs, out)
    grids = list(map(RunTable.read([run_directory(run, out) for run in runs], "pedestrians").cross, METRICS))
    tables = [f"{markdown(grid.header, grid.rows)}\n\n{grid.note}" for grid in grids]
    print("\n\n".join([printed_by("python studies/learn_together/run.py"), DESCRIPTION, *tables]))


def train_both(minutes: float) -> None:
    """Train the shared network, and the network of a vehicle among ORCA pedestrians, for some minutes each."""
    import numpy as np
    import supersuit
    from stable_baselines3.common.utils import set_random_seed

    from crowdbench import export_policy, parallel_env
    from crowdbench.envs import CrowdVecEnv

    set_random_seed(0)
    alone = CrowdVecEnv(WORLDS * 6, SCENARIO, **VIEW)
    # SuperSuit makes each agent a copy of the same learner; an agent at its goal observes zeros until the episode ends.
    single = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(parallel_env(SCENARIO, **VIEW)))
    worlds = supersuit.concat_vec_envs_v1(single, WORLDS, num_cpus=1, base_class="stable_baselines3")
    worlds.venv.reset(seed=0)
    together = learn(worlds, minutes)
    export_policy(together, TOGETHER, alone)
    hidden = together.policy.mlp_extractor.policy_net
    layers = enumerate((hidden[0], hidden[2], together.policy.action_net))
    arrays = [(f"{name[0]}{n}", part) for n, layer in layers for name, part in layer.named_parameters()]
    np.savez(WEIGHTS, **{name: part.detach().numpy() for name, part in arrays})
    export_policy(learn(alone, minutes), WITH_ORCA, alone)


def learn(worlds: Any, minutes: float) -> Any:
    """Train a network by PPO for some minutes of processor time."""
    import torch
    from stable_baselines3 import PPO

    torch.set_num_threads(1)  # networks this small are faster in one thread
    end = time.process_time() + 60.0 * minutes
    network = {"log_std_init": -0.5, "net_arch": [64, 64]}
    steps = {"n_steps": 64, "batch_size": 1024, "n_epochs": 6, "gamma": 0.97, "learning_rate": 7e-4}
    model = PPO("MlpPolicy", worlds, **steps, policy_kwargs=network, device="cpu")
    return model.learn(10**9, lambda *_: time.process_time() < end)


if __name__ == "__main__":
    main(cross_play)
