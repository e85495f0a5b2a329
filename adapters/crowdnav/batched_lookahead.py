"""The one-step lookahead of CrowdNav's SARL and LSTM-RL (Chen et al. 2019), with all actions in one batch."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import torch
from crowd_sim_step import fingerprint

PREDICT, ROTATE = "d21c7e7d7250", "2ae0be6c7e92"
"""Fingerprints of `MultiHumanRL.predict` and `CADRL.rotate`."""


def batch_lookahead() -> None:
    """Replace `MultiHumanRL.predict` of CrowdNav by `predict` if the script has imported it and its code is known."""
    module = sys.modules.get("crowd_nav.policy.multi_human_rl")
    policy = getattr(module, "MultiHumanRL", None)
    if policy is not None and fingerprint(policy.predict) == PREDICT and fingerprint(policy.rotate) == ROTATE:
        policy.predict = predict


def predict(policy: Any, state: Any) -> Any:
    """Return the action with the largest reward plus discounted value of the next state, or a random exploratory one.

    Values differ by rounding from CrowdNav's, because CrowdNav evaluates its network for one action at a time.

    Args:
        policy: The policy.
        state: Its `JointState`.
    """
    if policy.phase is None or policy.device is None:
        raise AttributeError("call set_phase and set_device of the policy first")
    if policy.phase == "train" and policy.epsilon is None:
        raise AttributeError("call set_epsilon of the policy first")
    robot = state.self_state
    if policy.action_space is None:
        policy.build_action_space(robot.v_pref)
    actions = policy.action_space
    if policy.reach_destination(state):
        return type(actions[0])(0, 0)
    # CrowdNav draws from NumPy's legacy generator in every phase.
    drawn = np.random.random()  # noqa: NPY002
    if policy.phase == "train" and drawn < policy.epsilon:
        chosen = actions[np.random.choice(len(actions))]  # noqa: NPY002
    else:
        policy.action_values = _values(policy, state)
        best = int(np.argmax(policy.action_values))
        if np.isnan(policy.action_values[best]):
            raise ValueError("the value network returns NaN")
        chosen = actions[best]
    if policy.phase == "train":
        policy.last_state = policy.transform(state)
    return chosen


def _values(policy: Any, state: Any) -> list[float]:
    """Return the value of each action."""
    robot, rewards, rows, kind = state.self_state, [], [], type(state.human_states[0])
    ahead: list[Any] = []
    for action in policy.action_space:
        own = policy.propagate(robot, action)
        if policy.query_env:
            ahead, reward, _, _ = policy.env.onestep_lookahead(action)
        else:
            ahead = ahead or [_straight(human, policy.time_step, kind) for human in state.human_states]
            reward = policy.compute_reward(own, ahead)
        rewards.append(reward)
        # Reversed below: a network stores the attention of a batch's first state, and CrowdNav that of the last action.
        rows.append([own + human for human in ahead])
    joint = torch.tensor(rows[::-1], dtype=torch.float32, device=policy.device)
    count, people, numbers = joint.shape
    inputs = policy.rotate(joint.view(-1, numbers)).view(count, people, -1)
    if policy.with_om:
        maps = policy.build_occupancy_maps(ahead).to(policy.device)
        inputs = torch.cat([inputs, maps.expand(count, *maps.shape)], dim=2)
    with torch.no_grad():
        values = policy.model(inputs).view(-1).flip(0).double().cpu().numpy()
    discount = policy.gamma ** (policy.time_step * robot.v_pref)
    found: list[float] = (np.array(rewards) + discount * values).tolist()
    return found


def _straight(human: Any, time_step: float, kind: type) -> Any:
    """Return the state of a pedestrian one step later at constant velocity."""
    x, y = human.px + time_step * human.vx, human.py + time_step * human.vy
    return kind(x, y, human.vx, human.vy, human.radius)
