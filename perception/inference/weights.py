"""Trained weights by name: where they lie, how they are saved, loaded and exported.

Each set is three files: `stairnetv2_025.safetensors` (the state dict), `.onnx` (for ONNX Runtime, any batch size) and
`.json` (the model card: data, seeds, epochs, metrics, commit). torch is imported only by what needs it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stair_env.common.console import quiet
from stair_env.common.constants import IMAGE_SIZE, NETWORK_WIDTHS
from stair_env.common.files import atomic_path, read_json_object
from stair_env.common.importing.extras import naming_extras

if TYPE_CHECKING:
    from perception.network import StairNetV2

WEIGHTS_DIR = Path(__file__).resolve().parents[1] / "weights"
KINDS = ("safetensors", "onnx", "json")
ONNX_OPSET = 18
DENSE_UP_TO_WIDTH = 0.25
ONNX_INPUTS = ("rgb", "depth")
ONNX_OUTPUTS = ("cls", "loc")


class WeightsError(ValueError):
    """Weights are missing or do not fit; the message names what there is."""


def weights_name(width: float) -> str:
    """File stem of a width's weights, such as "stairnetv2_025".

    Raises:
        WeightsError: no such width.
    """
    if width not in NETWORK_WIDTHS:
        raise WeightsError(f"width={width!r} must be one of {', '.join(map(str, NETWORK_WIDTHS))}")
    return f"stairnetv2_{round(width * 100):03d}"


def available_widths(kind: str = "safetensors", folder: Path = WEIGHTS_DIR) -> tuple[float, ...]:
    """Widths whose weights lie in the folder."""
    return tuple(width for width in NETWORK_WIDTHS if (folder / f"{weights_name(width)}.{kind}").is_file())


def weights_path(width: float, kind: str = "safetensors", folder: Path = WEIGHTS_DIR) -> Path:
    """The file of a width's weights.

    Args:
        width: 1.0, 0.5 or 0.25.
        kind: "safetensors", "onnx" or "json".
        folder: where to look.

    Raises:
        WeightsError: no such width or kind, or the file is missing; the message lists the widths that are there.
    """
    if kind not in KINDS:
        raise WeightsError(f"kind={kind!r} must be one of {', '.join(KINDS)}")
    path = folder / f"{weights_name(width)}.{kind}"
    if not path.is_file():
        there = ", ".join(map(str, available_widths(kind, folder))) or "none"
        raise WeightsError(
            f"no {kind} weights for width={width} in {folder}; there are: {there}. "
            "`stair-env perception-train --export` writes them, and `stair-env perception-export` the onnx file"
        )
    return path


def load_network(width: float = 0.25, folder: Path = WEIGHTS_DIR) -> StairNetV2:
    """The trained network by width, in evaluation mode.

    Raises:
        WeightsError: the weights are missing or do not fit.
    """
    return load_weights(weights_path(width, "safetensors", folder), width)


def load_weights(path: str | Path, width: float, fusion_stage: int = 2) -> StairNetV2:
    """A network from a safetensors file, in evaluation mode.

    Raises:
        WeightsError: the file is missing, no safetensors, or of another network.
    """
    with naming_extras():
        from safetensors import SafetensorError
        from safetensors.torch import load_file

        from perception.network import StairNetV2

    if not Path(path).is_file():
        raise WeightsError(f"{path}: no such file")
    try:
        state = load_file(str(path))
    except (
        SafetensorError,
        ArithmeticError,
        AttributeError,
        LookupError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        raise WeightsError(f"{path}: not a safetensors file: {error}") from error
    network = StairNetV2(width, fusion_stage)
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        reason = str(error).splitlines()[-1].strip()
        raise WeightsError(
            f"{path}: not the weights of width={width}, fusion_stage={fusion_stage}: {reason}"
        ) from error
    return network.eval()


def save_weights(network: StairNetV2, folder: Path, card: dict[str, Any]) -> tuple[Path, ...]:
    """Write safetensors, onnx and model card of a network; each file appears whole or not at all.

    Args:
        network: trained.
        folder: for the three files.
        card: what the model card says (JSON-able).

    Returns:
        The three paths.
    """
    from safetensors.torch import save_file

    stem = weights_name(network.width)
    paths = tuple(folder / f"{stem}.{kind}" for kind in KINDS)
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    with atomic_path(paths[0]) as temporary:
        save_file(tensors, str(temporary))
    export_onnx(network, paths[1])
    with atomic_path(paths[2]) as temporary:
        temporary.write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
    return paths


def export_onnx(network: StairNetV2, path: Path) -> None:
    """Write the network for ONNX Runtime: batch norm folded, any batch size, opset 18.

    Args:
        network: its training mode does not matter and is left as it is.
        path: to write.
    """
    import torch

    from perception.inference.batchnorm_fusion import folded

    # Dense wins on CPUs while groups are few (0.25x: 60 against 68 ms); at 1x it would triple the arithmetic.
    plain = folded(network, dense=network.width <= DENSE_UP_TO_WIDTH)
    rgb, depth = torch.zeros(2, 3, IMAGE_SIZE, IMAGE_SIZE), torch.zeros(2, 1, IMAGE_SIZE, IMAGE_SIZE)
    batch = torch.export.Dim("batch", min=1, max=1024)
    with atomic_path(path) as temporary, quiet("torch.onnx"):
        torch.onnx.export(
            plain,
            (rgb, depth),
            str(temporary),
            input_names=list(ONNX_INPUTS),
            output_names=list(ONNX_OUTPUTS),
            opset_version=ONNX_OPSET,
            dynamic_shapes={"rgb": {0: batch}, "depth": {0: batch}},
            dynamo=True,
            external_data=False,
            verbose=False,
        )
        strip_traces(temporary)


def strip_traces(path: Path) -> None:
    """Take out of an exported file where in the source each operation came from, which is most of its text."""
    import onnx

    model = onnx.load(str(path))
    graph = model.graph
    for entry in (*graph.node, *graph.value_info, *graph.input, *graph.output, *graph.initializer, graph):
        del entry.metadata_props[:]
    onnx.save(model, str(path))


def read_card(width: float, folder: Path = WEIGHTS_DIR) -> dict[str, Any]:
    """The model card of a width's weights.

    Raises:
        WeightsError: it is missing.
        ValueError: it is no JSON object.
    """
    return read_json_object(weights_path(width, "json", folder))
