import numpy as np
import pytest
import torch
from joint_states import scenes
from torch import nn

from crowdbench.networks.evaluation import evaluate
from crowdbench.networks.joint_state import DISTANCE, VEHICLE, joint_states
from crowdbench.networks.value import NETWORKS

EVERY = pytest.mark.parametrize("name", list(NETWORKS))


def network(name):
    """Untrained, in float64, so that rounding hides nothing."""
    torch.manual_seed(0)
    return NETWORKS[name]().double()


def crowds(shape=(40,), pedestrians=5, seed=0):
    """Joint states and who is present: of many worlds the first is empty and the second full."""
    arguments = scenes(np.random.default_rng(seed), shape, pedestrians)
    if shape:
        arguments["present"][0], arguments["present"][1] = False, True
    else:
        arguments["present"][:] = np.arange(pedestrians + 1) != 2
    return torch.from_numpy(joint_states(**arguments)).double(), torch.from_numpy(arguments["present"][..., 1:])


def close(one, other, atol, rtol=0.0):
    np.testing.assert_allclose(one.detach(), other.detach(), rtol=rtol, atol=atol)


def garbage(joint, present):
    """The same joint states with large numbers in the absent pedestrians' places."""
    noise = 1e4 * torch.from_numpy(np.random.default_rng(9).normal(size=joint.shape))
    noise[..., :VEHICLE] = joint[..., :VEHICLE]
    return torch.where(present[..., None], joint, noise)


# Slow versions: one world, only those present, NumPy, from the weights.


def weights(module):
    return {name: values.detach().numpy() for name, values in module.named_parameters()}


def slow_perceptron(layers, x, last=False):
    matrices = [weights(layer) for layer in layers if isinstance(layer, nn.Linear)]
    for n, layer in enumerate(matrices, 1):
        x = layer["weight"] @ x + layer["bias"]
        if n < len(matrices) or last:
            x = np.maximum(x, 0.0)
    return x


def slow_cadrl(net, rows):
    values = [slow_perceptron(net.pair, row)[0] for row in rows]
    return min(values), np.arange(len(rows)) == np.argmin(values)


def sigmoid(x):
    return 1.0 / (1.0 + np.exp(-x))


def slow_lstm_rl(net, rows):
    cell = weights(net.lstm)
    hidden, memory = np.zeros(50), np.zeros(50)
    for row in sorted(rows, key=lambda row: -row[DISTANCE]):
        gates = cell["weight_ih_l0"] @ row + cell["bias_ih_l0"] + cell["weight_hh_l0"] @ hidden + cell["bias_hh_l0"]
        enter, forget, new, out = gates.reshape(4, 50)
        memory = sigmoid(forget) * memory + sigmoid(enter) * np.tanh(new)
        hidden = sigmoid(out) * np.tanh(memory)
    value = slow_perceptron(net.value, np.concatenate([rows[0][:VEHICLE], hidden]))[0]
    return value, np.full(len(rows), 1.0 / len(rows))


def slow_sarl(net, rows):
    embeddings = [slow_perceptron(net.embedding, row, last=True) for row in rows]
    mean = np.mean(embeddings, axis=0)
    matrix = np.concatenate([weights(net.attention_own)["weight"], weights(net.attention_mean)["weight"]], axis=1)
    joined = [matrix @ np.concatenate([e, mean]) + weights(net.attention_own)["bias"] for e in embeddings]
    scores = np.array([slow_perceptron(net.attention, np.maximum(one, 0.0))[0] for one in joined])
    attention = np.exp(scores) / np.exp(scores).sum()
    crowd = sum(share * slow_perceptron(net.features, e) for share, e in zip(attention, embeddings, strict=True))
    return slow_perceptron(net.value, np.concatenate([rows[0][:VEHICLE], crowd]))[0], attention


SLOW = {"cadrl": slow_cadrl, "lstm_rl": slow_lstm_rl, "sarl": slow_sarl}


@EVERY
def test_networks_are_those_of_the_papers(name):
    net, (joint, present) = network(name), crowds()
    value, attention = net.attend(joint, present)
    assert torch.equal(value, net(joint, present))
    checked = 0
    for w in np.flatnonzero(present.any(-1)):
        there = present[w].numpy()
        slow_value, slow_attention = SLOW[name](net, joint[w].numpy()[there])
        np.testing.assert_allclose(value[w].item(), slow_value, rtol=1e-9)
        np.testing.assert_allclose(attention[w].detach().numpy()[there], slow_attention, rtol=1e-6, atol=1e-9)
        checked += 1
    assert checked > 30


@pytest.mark.parametrize(("name", "numbers"), [("cadrl", 27401), ("lstm_rl", 46851), ("sarl", 96502)])
def test_networks_have_the_published_sizes(name, numbers):
    assert sum(values.numel() for values in network(name).parameters()) == numbers


@EVERY
def test_the_order_of_pedestrians_changes_nothing(name):
    net, (joint, present) = network(name), crowds()
    order = torch.tensor([3, 0, 4, 2, 1])
    value, attention = net.attend(joint, present)
    other_value, other_attention = net.attend(joint[:, order], present[:, order])
    close(other_value, value, atol=1e-12)
    close(other_attention, attention[:, order], atol=1e-12)


@EVERY
@pytest.mark.parametrize("more", [0, 1, 7])
def test_the_absent_change_nothing(name, more):
    net, (joint, present) = network(name).float(), crowds()
    wide = torch.cat([joint, joint[:, :1].expand(-1, more, -1)], 1)
    wide_present = nn.functional.pad(present, (0, more))
    value, attention = net.attend(joint.float(), present)
    other_value, other_attention = net.attend(garbage(wide, wide_present).float(), wide_present)
    close(other_value, value, atol=1e-6)
    close(other_attention[:, :5], attention, atol=1e-6)


@EVERY
def test_attention_sums_to_one_and_the_absent_get_none(name):
    joint, present = crowds()
    attention = network(name).attend(garbage(joint, present), present)[1]
    assert (attention >= 0.0).all()
    assert (attention[~present] == 0.0).all()
    close(attention.sum(-1), present.any(-1).to(attention), atol=1e-6)


@EVERY
def test_nobody_present_is_worth_the_discounted_way(name):
    arguments = scenes(np.random.default_rng(5), (30,), 0)
    arguments["goal"][0] = arguments["position"][0, 0]
    joint = torch.from_numpy(joint_states(**arguments)).double()
    value = network(name)(joint, torch.zeros(30, 1, dtype=torch.bool))
    way = np.linalg.norm(arguments["goal"] - arguments["position"][:, 0], axis=-1) - arguments["radius"][:, 0]
    np.testing.assert_allclose(value.detach(), 0.9 ** np.maximum(way, 0.0), rtol=1e-6)


@EVERY
@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3, 4)])
def test_any_batch_shape_is_the_same_states(name, shape):
    net, (joint, present) = network(name), crowds(shape if 0 not in shape else (3,))
    if 0 in shape:
        joint, present = joint[:0], present[:0]
    value, attention = net.attend(joint, present)
    assert (value.shape, attention.shape) == (shape, (*shape, 5))
    for world in np.ndindex(shape):
        alone = net.attend(joint[world][None], present[world][None])
        close(value[world], alone[0][0], atol=1e-12)
        close(attention[world], alone[1][0], atol=1e-12)


def gradients(net, joint, present):
    net.zero_grad()
    (net(joint, present) ** 2).sum().backward()
    return {name: values.grad.clone() for name, values in net.named_parameters()}


@EVERY
def test_gradients_are_those_of_each_world_without_the_absent(name):
    net, (joint, present) = network(name), crowds((8,))
    together = gradients(net, garbage(joint, present), present)
    expected = {key: torch.zeros_like(values) for key, values in together.items()}
    for w in np.flatnonzero(present.any(-1)):
        there = present[w]
        for key, values in gradients(net, joint[w, there][None], there[there][None]).items():
            expected[key] += values
    for key, values in together.items():
        assert values.isfinite().all()
        # A constant added to all scores changes no attention: that one has no gradient but rounding.
        assert values.abs().max() > 1e-6 or key == "attention.2.bias"
        close(values, expected[key], atol=1e-9, rtol=1e-6)


@EVERY
@pytest.mark.parametrize("everybody", [True, False])
@pytest.mark.parametrize("number", [1, 67])
def test_a_network_is_asked_for_few_numbers_of_rows_and_answers_for_all_that_were_given(name, everybody, number):
    net, given = network(name), []
    joint, present = crowds((max(number, 2),))
    joint, present = joint[:number], (present | everybody)[:number]
    expected = net.attend(joint, present)
    attend = net.attend
    net.attend = lambda *arguments: given.append(arguments[1]) or attend(*arguments)
    found = evaluate(net, joint.numpy(), present.numpy())
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other.detach(), rtol=0.0, atol=1e-12)
    [asked] = given
    assert asked.all() == everybody
    for rows in (len(asked),) if everybody else (len(asked), int(asked.sum())):
        assert rows < 16 or rows % 2 ** (rows.bit_length() - 4) == 0
