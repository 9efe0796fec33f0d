"""The network on a graphics card through ONNX Runtime: CUDA, or TensorRT, which compiles it for the card first.

Needs `pip install onnxruntime-gpu` in place of onnxruntime (and TensorRT's own libraries for TensorRT). Whole batches
run at once, unlike on a processor.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from perception.inference.backend_interface import BackendError, as_grids, check_batch, check_network, empty_answer
from perception.inference.preprocess import colour_input, depth_input
from perception.inference.weights import WeightsError
from stair_env.common.constants import IMAGE_SIZE
from stair_env.common.importing.extras import naming_extras

MAX_BATCH = 32  # frames that run at once
TENSORRT = "TensorrtExecutionProvider"
CPU = "CPUExecutionProvider"
CUDA = "CUDAExecutionProvider"
PROVIDERS = {"onnx-cuda": CUDA, "onnx-tensorrt": TENSORRT}  # by the name of the back end
CACHE_VARIABLE = "STAIR_ENV_TENSORRT_CACHE"  # folder in which TensorRT's engines are kept between runs


class GraphicsCardBackend:
    """An exported network on a provider of ONNX Runtime that takes whole batches.

    Args:
        path: what `perception.inference.weights.export_onnx` wrote.
        provider: ONNX Runtime's name: "CUDAExecutionProvider" or "TensorrtExecutionProvider".
        max_batch: frames that run at once.

    Raises:
        BackendError: this ONNX Runtime has no such provider, or it found no card; it would fall back to the processor
            without a word.
        WeightsError: the file is missing or no network of ours.
        ValueError: max_batch < 1.
    """

    def __init__(self, path: str | Path, provider: str = CUDA, *, max_batch: int = MAX_BATCH) -> None:
        if max_batch < 1:
            raise ValueError(f"max_batch={max_batch!r} must be at least 1")
        file = Path(path)
        if not file.is_file():
            raise WeightsError(f"{file}: no such file")
        self._max_batch = max_batch
        self._session = _open_session(file, provider, max_batch)
        check_network(file, self._session)

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Detect on a batch; see `perception.inference.backends.Backend`."""
        check_batch(rgb, depth_m)
        if len(rgb) == 0:
            return empty_answer()
        parts = [slice(i, i + self._max_batch) for i in range(0, len(rgb), self._max_batch)]
        answers = [self._run(rgb[part], depth_m[part]) for part in parts]
        return as_grids(np.concatenate([a[0] for a in answers]), np.concatenate([a[1] for a in answers]))

    def _run(self, rgb: np.ndarray, depth_m: np.ndarray) -> list[np.ndarray]:
        inputs = {"rgb": colour_input(rgb), "depth": depth_input(depth_m)}
        answer: list[np.ndarray] = self._session.run(["cls", "loc"], inputs)
        return answer


def _open_session(file: Path, provider: str, max_batch: int) -> Any:
    with naming_extras():
        import onnxruntime

    there = onnxruntime.get_available_providers()
    if provider not in there:
        raise BackendError(
            f"{provider} is not in this onnxruntime {onnxruntime.__version__}, which has {', '.join(there)}: "
            "pip uninstall onnxruntime, pip install onnxruntime-gpu"
        )
    chain: list[Any] = [(provider, _options(provider, max_batch))]
    if provider == TENSORRT:
        chain.append((CUDA, {}))  # what TensorRT does not know
    try:
        session = onnxruntime.InferenceSession(str(file), providers=chain)
    except Exception as error:  # the runtime's errors share no base class
        raise WeightsError(f"{file}: cannot be loaded: {' '.join(str(error).split())}") from error
    if session.get_providers()[0] != provider:
        raise BackendError(
            f"{provider} could not start and ONNX Runtime fell back to {session.get_providers()[0]}: "
            "no graphics card, or CUDA libraries of another version"
        )
    return session


def _options(provider: str, max_batch: int) -> dict[str, str]:
    """Of a provider. TensorRT compiles for batches of 1 to max_batch in float32, once where a cache is named."""
    if provider != TENSORRT:
        return {}
    shapes = {
        count: f"rgb:{size}x3x{IMAGE_SIZE}x{IMAGE_SIZE},depth:{size}x1x{IMAGE_SIZE}x{IMAGE_SIZE}"
        for count, size in (("min", 1), ("opt", min(8, max_batch)), ("max", max_batch))
    }
    options = {f"trt_profile_{count}_shapes": shape for count, shape in shapes.items()}
    folder = os.environ.get(CACHE_VARIABLE)
    if folder:
        options |= {"trt_engine_cache_enable": "1", "trt_engine_cache_path": folder}
    return options
