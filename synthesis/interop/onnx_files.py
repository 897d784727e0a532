"""ONNX: graphs from rows to actions, read by onnxruntime (the extra ``onnx``), and files of networks.

A graph has one input, rows (N, n), and its first output is actions (N, m). Files that this package writes say in their
metadata, under ``certigym``, in which environment their model acts; of others somebody has to say it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..relations.kinds import Network
from .detected import REMEMBERS, Detected, agreed, origins
from .layers import of_relus

SAYS = "ONNX (.onnx)"

EXTRA = 'ONNX needs onnx and onnxruntime: install "certigym[onnx]"'
KEY = "certigym"

FUNCTIONS = {"Tanh": "tanh", "Relu": "relu", "Sigmoid": "sigmoid", "Elu": "elu"}
"""Activations by their operators; silu is a product with the sigmoid of the same numbers."""

LEAKY = ("LeakyRelu", "PRelu")
"""Activations that are lines on both sides of 0, of which relus are made."""


def recognises(model: Any) -> bool:
    """Return whether a model is a session of onnxruntime, or a graph of ONNX."""
    return "onnxruntime" in origins(model) or ("onnx" in origins(model) and hasattr(model, "graph"))


def read(model: Any, facts: dict[str, Any]) -> Detected:
    """Return what a session or a graph is."""
    if hasattr(model, "graph"):
        return _read(model.SerializeToString(), "a graph of ONNX")
    return _of_session(model, "a session of onnxruntime", None, "only files and graphs say what their layers are")


def read_file(path: Path, facts: dict[str, Any]) -> Detected:
    """Return what a file holds."""
    return _read(path.read_bytes(), f"the file {path.name}")


def env_of(path: Path) -> str | None:
    """Return the environment that a file of this package names; None for other files."""
    onnx, _ = needed()
    facts = {entry.key: entry.value for entry in onnx.load(str(path)).metadata_props}
    return str(json.loads(facts[KEY])["env"]) if KEY in facts else None


def needed() -> tuple[Any, Any]:
    """Return the packages onnx and onnxruntime, or raise ValueError that names the extra."""
    try:
        import onnx
        import onnxruntime
    except ImportError as error:
        raise ValueError(EXTRA) from error
    return onnx, onnxruntime


def written(network: Network, metadata: dict[str, Any]) -> bytes:
    """Return a network as a file of ONNX: rows (N, n) to actions (N, m), float32, clipped or squashed if in [-1, 1]."""
    onnx, _ = needed()
    make, nodes, stored, name = onnx.helper, [], [], "rows"
    layers = list(zip(network.weights, network.biases, strict=True))
    for k, (weight, bias) in enumerate(layers):
        stored += [onnx.numpy_helper.from_array(np.ascontiguousarray(a), f"{kind}_{k}")
                   for kind, a in (("weight", weight), ("bias", bias))]  # fmt: skip
        nodes.append(make.make_node("Gemm", [name, f"weight_{k}", f"bias_{k}"], [f"sum_{k}"], transB=1))
        name = f"sum_{k}"
        if k < len(layers) - 1:
            if network.activation == "silu":
                nodes.append(make.make_node("Sigmoid", [name], [f"share_{k}"]))
                nodes.append(make.make_node("Mul", [name, f"share_{k}"], [f"value_{k}"]))
            else:
                kind = next(op for op, function in FUNCTIONS.items() if function == network.activation)
                nodes.append(make.make_node(kind, [name], [f"value_{k}"]))
            name = f"value_{k}"
    if network.squashed:
        nodes.append(make.make_node("Tanh", [name], ["actions"]))
    elif network.outputs == "unit":
        stored += [onnx.numpy_helper.from_array(np.float32(end), text) for end, text in ((-1, "least"), (1, "most"))]
        nodes.append(make.make_node("Clip", [name, "least", "most"], ["actions"]))
    else:
        nodes.append(make.make_node("Identity", [name], ["actions"]))
    sizes = ("rows", layers[0][0].shape[1]), ("actions", layers[-1][0].shape[0])
    ends = [make.make_tensor_value_info(text, onnx.TensorProto.FLOAT, ["N", size]) for text, size in sizes]
    graph = make.make_graph(nodes, "policy", [ends[0]], [ends[1]], stored)
    model = make.make_model(graph, opset_imports=[make.make_opsetid("", 17)], ir_version=9)
    onnx.helper.set_model_props(model, {KEY: json.dumps(metadata)})
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())


def _read(content: bytes, name: str) -> Detected:
    """Return what the bytes of a file are."""
    onnx, onnxruntime = needed()
    from google.protobuf.message import DecodeError

    try:
        graph = onnx.load_from_string(content).graph
    except DecodeError as error:
        raise ValueError(f"`policy`: expected {name} to be of ONNX: {error}") from error
    session = onnxruntime.InferenceSession(content)
    chain = _chain(onnx, graph)
    network, why = (chain, "") if isinstance(chain, Network) else (None, chain)
    return _of_session(session, name, network, why)


def _of_session(session: Any, name: str, network: Network | None, why: str) -> Detected:
    """Return what a session answers, and the network that it is."""
    if len(session.get_inputs()) != 1:
        told = ", ".join(own.name for own in session.get_inputs())
        raise ValueError(f"`policy`: expected one input of {name}, rows of numbers, got {told}: if {REMEMBERS}")
    (rows,), answers = session.get_inputs(), session.get_outputs()
    sizes = [shape[-1] if shape and isinstance(shape[-1], int) else None for shape in (rows.shape, answers[0].shape)]
    kind = np.float64 if "double" in rows.type else np.float32

    def act(told: Any) -> Any:
        return session.run([answers[0].name], {rows.name: np.asarray(told, dtype=kind)})[0]

    networks = () if network is None else (network,)
    return agreed(Detected(name, sizes[0], sizes[1], act=act, networks=networks, why_not=why))


def _chain(onnx: Any, graph: Any) -> Network | str:
    """Return the network that a graph is, linear steps with an activation between, or why it is none."""
    stored = {tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in graph.initializer}
    constants = [node for node in graph.node if node.op_type == "Constant"]
    stored |= {node.output[0]: onnx.numpy_helper.to_array(node.attribute[0].t) for node in constants}
    weights, biases, kinds, ends, name = list[Any](), list[Any](), list[str](), "", graph.input[0].name
    before, below = "", dict[int, Any]()  # what the last activation was taken of, and slopes of lines with a kink
    for node in (node for node in graph.node if node.op_type != "Constant"):
        if node.op_type == "Mul" and {*node.input} == {before, name} and kinds[-1:] == ["sigmoid"]:
            name, before, kinds[-1] = node.output[0], "", "silu"
            continue
        if [other for other in node.input if other not in stored] != [name]:
            return f"its step {node.op_type} does not follow the one before it"
        before, name = name, node.output[0]
        if node.op_type == "Identity":
            continue
        others = [stored[other] for other in node.input if other in stored]
        if ends:
            return f"it goes on with {node.op_type} behind its outputs"
        if node.op_type in ("Gemm", "MatMul"):
            options = {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}
            if len(kinds) < len(weights) or any(options.get(k, 1.0) != 1.0 for k in ("alpha", "beta")):
                return "it has linear steps with nothing between them"
            weight = others[0] if options.get("transB") else others[0].T
            weights.append(weight)
            biases.append(others[1] if len(others) > 1 else np.zeros(len(weight), weight.dtype))
        elif node.op_type == "Add" and others and len(weights) == len(kinds) + 1:
            biases[-1] = biases[-1] + others[0]
        elif node.op_type in FUNCTIONS:
            if any(onnx.helper.get_attribute_value(own) != 1.0 for own in node.attribute):
                return f"its {node.op_type} has another alpha than 1"
            kinds.append(FUNCTIONS[node.op_type])
        elif node.op_type in LEAKY:
            alpha = [onnx.helper.get_attribute_value(own) for own in node.attribute] or [0.01]
            below[len(kinds)] = np.float32(alpha[0]) if node.op_type == "LeakyRelu" else others[0].ravel()
            kinds.append("relu")
        elif node.op_type == "Clip":
            least, most = (float(end) for end in others) if len(others) == 2 else (0.0, 0.0)
            if (least, most) != (-1.0, 1.0):
                return f"it clips to [{least:g}, {most:g}]"
            ends = "clipped"
        else:
            return f"it has a step {node.op_type}"
    squashed = len(kinds) == len(weights)
    inner = set(kinds[:-1] if squashed else kinds)
    if not weights or len(kinds) not in (len(weights), len(weights) - 1) or len(inner) > 1:
        return "it is no chain of linear steps with one kind of activation between them"
    if squashed and (kinds[-1] != "tanh" or ends):
        return "its outputs go through another activation than tanh, or are clipped behind it"
    if any(array.dtype != np.float32 for array in (*weights, *biases)):
        return "its numbers are not of single precision (float32)"
    activation = inner.pop() if inner else "relu"
    if below:
        slopes = [np.broadcast_to(below.get(k, np.float32(0.0)), bias.shape) for k, bias in enumerate(biases[:-1])]
        weights, biases = of_relus(weights, biases, slopes)
    return Network(tuple(weights), tuple(biases), activation, squashed, "unit" if ends or squashed else "box")
