"""Networks in ONNX files whose batch is fixed, as most exporters write them."""

import numpy as np
import pytest
from helpers import drive

from crowdbench import InputError, load_planner, load_scenario
from crowdbench.envs import stepping
from crowdbench.sim.sensor import observe

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime", reason="ONNX Runtime is not installed: pip install 'crowdbench[onnx]'")

FEATURES, UNITS = 5 + 9 * 10, 3
FIXED = 1, 4, 7

TOLERANCE = 1e-4
"""In m/s: products of matrices of other sizes are rounded otherwise."""


class Graph:
    """A small network as an ONNX file, node by node. Its batch is a number, or `world` if it is dynamic."""

    def __init__(self, batch, kind="FLOAT"):
        self.batch, self.kind = batch, getattr(onnx.TensorProto, kind)
        self.inputs, self.outputs, self.nodes, self.weights = [], [], [], []
        self.random = np.random.default_rng(0)

    def value(self, name, *shape):
        return onnx.helper.make_tensor_value_info(name, self.kind, shape)

    def input(self, name, *shape, batch=None):
        self.inputs.append(self.value(name, batch or self.batch, *shape))
        return name

    def constant(self, array):
        name = f"constant_{len(self.weights)}"
        dtype = onnx.helper.tensor_dtype_to_np_dtype(self.kind) if array.dtype == float else array.dtype
        self.weights.append(onnx.numpy_helper.from_array(array.astype(dtype), name))
        return name

    def node(self, kind, *inputs, to=None, **attributes):
        name = to or f"node_{len(self.nodes)}"
        self.nodes.append(onnx.helper.make_node(kind, inputs, [name], **attributes))
        return name

    def linear(self, name, features, outputs, to=None):
        return self.node("MatMul", name, self.constant(0.3 * self.random.standard_normal((features, outputs))), to=to)

    def output(self, name, *shape):
        self.outputs.append(self.value(name, *shape))

    def save(self, folder):
        graph = onnx.helper.make_graph(self.nodes, "policy", self.inputs, self.outputs, self.weights)
        model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=9)
        onnx.checker.check_model(model)
        onnx.save(model, folder / f"policy_{self.batch}.onnx")
        return str(folder / f"policy_{self.batch}.onnx")


def feed_forward(batch, **options):
    graph = Graph(batch, **options)
    graph.linear(graph.input("obs", FEATURES), FEATURES, 2, to="action")
    graph.output("action", batch, 2)
    return graph


def float64(batch):
    return feed_forward(batch, kind="DOUBLE")


def without_output_batch(batch):
    """The action of a batch of one world is `[2]`."""
    if batch != 1:
        return feed_forward(batch)
    graph = Graph(batch)
    row = graph.linear(graph.input("obs", FEATURES), FEATURES, 2)
    graph.node("Squeeze", row, graph.constant(np.array([0])), to="action")
    graph.output("action", 2)
    return graph


def several_inputs(batch):
    graph = Graph(batch)
    pedestrians = graph.node("Flatten", graph.input("pedestrians", 10, 8))
    vehicle, mask = graph.input("vehicle", 5), graph.input("mask", 10)
    graph.linear(graph.node("Concat", vehicle, pedestrians, mask, axis=1), FEATURES, 2, to="action")
    graph.output("action", batch, 2)
    return graph


def recurrent(batch, observed="world"):
    """The batch is fixed in the state alone."""
    graph = Graph(batch)
    row = graph.linear(graph.input("obs", FEATURES, batch=observed), FEATURES, UNITS)
    graph.node("Tanh", graph.node("Add", row, graph.input("state_0", UNITS)), to="next_state_0")
    graph.linear("next_state_0", UNITS, 2, to="action")
    graph.output("action", batch, 2)
    graph.output("next_state_0", batch, UNITS)
    return graph


def load(graph, folder):
    observation = "dict" if len(graph.inputs) > 2 else "goal_frame"
    return load_planner(graph.save(folder), {"observation": observation, "action": "goal_frame"})


@pytest.mark.parametrize("network", [feed_forward, float64, without_output_batch, several_inputs, recurrent])
def test_a_network_with_a_fixed_batch_drives_as_with_a_dynamic_one(network, tmp_path):
    expected = drive(load(network("world"), tmp_path), "6")
    assert np.nanstd(expected.command) > 0.05
    for batch in FIXED:
        trace = drive(load(network(batch), tmp_path), "6")
        np.testing.assert_allclose(trace.command, expected.command, atol=TOLERANCE)
    alone = drive(load(network(4), tmp_path), "test/5")
    steps = alone.command.shape[1]
    np.testing.assert_allclose(alone.command[0], expected.command[5, :steps], atol=TOLERANCE)


def test_a_network_without_a_batch_axis_drives(tmp_path):
    graph = Graph("world")
    graph.inputs.append(graph.value("obs", FEATURES))
    graph.inputs.append(graph.value("state", UNITS))
    graph.node("Tanh", graph.node("Add", graph.linear("obs", FEATURES, UNITS), "state"), to="next")
    graph.linear("next", UNITS, 2, to="action")
    graph.output("action", 2)
    graph.output("next", UNITS)
    expected = drive(load(recurrent("world"), tmp_path), "4")
    trace = drive(load(graph, tmp_path), "4")
    np.testing.assert_allclose(trace.command, expected.command, atol=TOLERANCE)


def test_different_fixed_batches_get_one_sentence(tmp_path):
    with pytest.raises(InputError, match="must be the same batch, but is 1 in obs, 2 in state_0"):
        load(recurrent(2, observed=1), tmp_path)


def test_a_fixed_batch_of_another_observation_gets_one_sentence(tmp_path):
    planner = load_planner(feed_forward(1).save(tmp_path), {"observation": "flat", "action": "goal_frame"})
    obs = observe(stepping.start(load_scenario("circle_crossing_5"), ["test/0"]))
    with pytest.raises(InputError, match=r"does not fit the scenario, or option observation.*Got: 36 Expected: 95"):
        planner.plan(obs)
