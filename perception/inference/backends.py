"""Runs the network on letterboxed frames: ONNX Runtime (fast on CPUs, no torch needed), OpenVINO (faster) or torch.

Every back end takes and gives the same numpy arrays, for any batch size, and they agree to 1e-3. Those of graphics
cards are in `perception.inference.graphics_card`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from perception.inference.backend_interface import (
    Backend,
    BackendError,
    as_grids,
    check_batch,
    check_network,
    empty_answer,
)
from perception.inference.preprocess import NEAREST_DEPTH_M, close_small_holes, colour_input, depth_input
from perception.inference.weights import DENSE_UP_TO_WIDTH, WeightsError, load_network, weights_path
from stair_env.common.constants import BACKENDS, EXPORTED_BACKENDS, GPU_BACKENDS, IMAGE_SIZE
from stair_env.common.importing.extras import naming_extras
from stair_env.common.validation import check_choice

__all__ = [
    "BACKENDS",
    "EXPORTED_BACKENDS",
    "Backend",
    "BackendError",
    "OnnxBackend",
    "OpenVinoBackend",
    "TorchBackend",
    "as_grids",
    "check_batch",
    "empty_answer",
    "make_backend",
    "make_exported_backend",
]

if TYPE_CHECKING:
    from perception.network import StairNetV2

MAX_BATCH = 8  # frames that torch runs at once: larger batches only push intermediate results out of the cache


class OnnxBackend:
    """ONNX Runtime on the CPU.

    Args:
        width: of the shipped weights to load.
        path: an exported file to load instead.
        threads: of one frame, and frames of a batch that run at once; None takes all cores.

    Raises:
        WeightsError: the weights are missing or no network of ours.
    """

    def __init__(self, width: float = 0.25, *, path: str | Path | None = None, threads: int | None = None) -> None:
        file = Path(path) if path is not None else weights_path(width, "onnx")
        if not file.is_file():
            raise WeightsError(f"{file}: no such file")
        self._threads = _check_threads(threads) or _available_cores()
        self._session = _open_session(file, _check_threads(threads) or 0)
        check_network(file, self._session)
        # Several frames: each on one thread of its own, which need not wait for the others at every layer.
        self._alone = _open_session(file, 1) if self._threads > 1 else self._session

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Detect on a batch; see `Backend`."""
        check_batch(rgb, depth_m)
        if len(rgb) == 0:
            return empty_answer()
        if len(rgb) == 1 or self._threads == 1:
            answers = [_run_frame(self._session, rgb[i : i + 1], depth_m[i : i + 1]) for i in range(len(rgb))]
        else:
            # The threads live for this call only: kept ones would not survive a fork.
            with ThreadPoolExecutor(min(self._threads, len(rgb))) as pool:
                frames = [(self._alone, rgb[i : i + 1], depth_m[i : i + 1]) for i in range(len(rgb))]
                answers = list(pool.map(_run_frame, *zip(*frames)))
        return as_grids(np.concatenate([a[0] for a in answers]), np.concatenate([a[1] for a in answers]))


def _open_session(file: Path, threads: int) -> Any:
    """An ONNX Runtime session on the CPU; 0 threads lets the runtime take all cores."""
    with naming_extras():
        import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Waiting threads would otherwise spin on cores that the physics and the renderer need.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the runtime's errors share no base class
        raise WeightsError(f"{file}: cannot be loaded: {' '.join(str(error).split())}") from error


def _run_frame(session: Any, rgb: np.ndarray, depth_m: np.ndarray) -> list[np.ndarray]:
    """[cls, loc] of one frame, (1, 512, 512, 3) and (1, 512, 512)."""
    answer: list[np.ndarray] = session.run(["cls", "loc"], {"rgb": colour_input(rgb), "depth": depth_input(depth_m)})
    return answer


def _available_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class OpenVinoBackend:
    """OpenVINO on the CPU, from the same exported file as ONNX Runtime; needs the extra `stair-env[openvino]`.

    Colour and depth are scaled within the compiled network, which saves their way through memory.

    Args:
        width: of the shipped weights to load.
        path: an exported file to load instead.
        threads: of one frame, and frames of a batch that run at once; None takes all cores.

    Raises:
        BackendError: OpenVINO is not installed.
        WeightsError: the weights are missing or no network of ours.
    """

    def __init__(
        self,
        width: float = 0.25,
        *,
        path: str | Path | None = None,
        threads: int | None = None,
    ) -> None:
        file = Path(path) if path is not None else weights_path(width, "onnx")
        if not file.is_file():
            raise WeightsError(f"{file}: no such file")
        self._threads = _check_threads(threads) or _available_cores()
        self._model = _read_openvino_model(file)
        self._request = self._compile(streams=1).create_infer_request()
        self._queue: Any = None  # of several frames at once; compiled when the first batch comes

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Detect on a batch; see `Backend`."""
        check_batch(rgb, depth_m)
        if len(rgb) == 0:
            return empty_answer()
        depth = np.stack([close_small_holes(frame) for frame in depth_m])[:, None]
        cls, loc = np.empty((len(rgb), 1, 32, 16), np.float32), np.empty((len(rgb), 8, 32, 16), np.float32)

        def keep(request: Any, index: int) -> None:
            cls[index], loc[index] = request.get_tensor("cls").data[0], request.get_tensor("loc").data[0]

        frames = ({"rgb": np.ascontiguousarray(rgb[i : i + 1]), "depth": depth[i : i + 1]} for i in range(len(rgb)))
        if len(rgb) == 1 or self._threads == 1:
            for index, frame in enumerate(frames):
                self._request.infer(frame, share_inputs=True)
                keep(self._request, index)
        else:
            self._run_at_once(list(frames), keep)
        return as_grids(cls, loc)

    def _run_at_once(self, frames: list[dict[str, np.ndarray]], keep: Callable[[Any, int], None]) -> None:
        """Frames side by side, each on one thread of its own; `keep` takes each finished request and its index."""
        from openvino import AsyncInferQueue

        if self._queue is None:
            self._queue = AsyncInferQueue(self._compile(streams=self._threads), self._threads)
        self._queue.set_callback(keep)
        for index, frame in enumerate(frames):
            self._queue.start_async(frame, index, share_inputs=True)
        self._queue.wait_all()

    def _compile(self, streams: int) -> Any:
        """The network for frames of which `streams` run at once."""
        with naming_extras():
            from openvino import Core

        settings = {
            "INFERENCE_PRECISION_HINT": "f32",  # left to itself it takes bfloat16: 14 points of IOU less
            "INFERENCE_NUM_THREADS": self._threads,
            "NUM_STREAMS": streams,
            "ENABLE_CPU_PINNING": False,  # a thread bound to a core waits for whatever else runs there
        }
        return Core().compile_model(self._model, "CPU", settings)


def _read_openvino_model(file: Path) -> Any:
    """An exported network for OpenVINO that takes one frame as the camera gives it: uint8 colour and metres.

    Raises:
        BackendError: OpenVINO is not installed.
        WeightsError: the file is no network of ours.
    """
    try:
        import openvino
        from openvino import opset13 as op
        from openvino.preprocess import PrePostProcessor
    except ImportError as error:
        raise BackendError(f"OpenVINO cannot be imported ({error}): pip install 'stair-env[openvino]'") from error

    try:
        model = openvino.Core().read_model(str(file))
    except RuntimeError as error:
        raise WeightsError(f"{file}: cannot be loaded: {' '.join(str(error).split())}") from error
    names = sorted(entry.any_name for entry in model.inputs)
    if names != ["depth", "rgb"]:
        raise WeightsError(f"{file}: has inputs {names}, a StairNetV2 has rgb and depth")
    model.reshape({"rgb": [1, 3, IMAGE_SIZE, IMAGE_SIZE], "depth": [1, 1, IMAGE_SIZE, IMAGE_SIZE]})

    def constant(value: float) -> Any:
        return op.constant(np.float32(value))

    def inverse_depth(depth: Any) -> Any:  # perception.inference.preprocess.depth_input
        scaled = op.divide(constant(2.0 * NEAREST_DEPTH_M), op.maximum(depth, constant(NEAREST_DEPTH_M)))
        near = op.subtract(scaled, constant(1.0))
        return op.select(op.greater(depth, constant(0.0)), near, constant(-1.0)).output(0)

    steps = PrePostProcessor(model)
    colour = steps.input("rgb")
    colour.tensor().set_element_type(openvino.Type.u8).set_layout(openvino.Layout("NHWC"))
    colour.model().set_layout(openvino.Layout("NCHW"))
    colour.preprocess().convert_element_type(openvino.Type.f32).mean(127.5).scale(127.5)  # colour_input
    steps.input("depth").preprocess().custom(inverse_depth)
    return steps.build()


class TorchBackend:
    """torch with folded batch norm and channels-last memory.

    Args:
        width: of the shipped weights to load.
        network: a network to run instead; it is copied.
        threads: torch's, for the whole process; None leaves them as they are.
        device: "cpu", "cuda", ...

    Raises:
        BackendError: torch sees no such device.
        WeightsError: the weights are missing.
    """

    def __init__(
        self,
        width: float = 0.25,
        *,
        network: StairNetV2 | None = None,
        threads: int | None = None,
        device: str = "cpu",
    ) -> None:
        import torch

        from perception.inference.batchnorm_fusion import folded

        if _check_threads(threads):
            torch.set_num_threads(int(threads or 1))
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise BackendError(
                f"device={device!r}: torch {torch.__version__} sees no graphics card; use the CPU's back ends"
            )
        source = network if network is not None else load_network(width)
        dense = device == "cpu" and source.width <= DENSE_UP_TO_WIDTH
        self._network = folded(source, dense=dense).to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._device = device

    def __call__(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Detect on a batch; see `Backend`."""
        check_batch(rgb, depth_m)
        if len(rgb) == 0:
            return empty_answer()
        answers = [self._run(rgb[i : i + MAX_BATCH], depth_m[i : i + MAX_BATCH]) for i in range(0, len(rgb), MAX_BATCH)]
        return as_grids(np.concatenate([a[0] for a in answers]), np.concatenate([a[1] for a in answers]))

    def _run(self, rgb: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        import torch

        with torch.inference_mode():
            inputs = (
                torch.from_numpy(array).to(self._device, memory_format=torch.channels_last)
                for array in (colour_input(rgb), depth_input(depth_m))
            )
            cls, loc = self._network(*inputs)
            return cls.cpu().numpy(), loc.cpu().numpy()


def make_backend(name: str, width: float = 0.25, threads: int | None = None) -> Backend:
    """A back end over the shipped weights.

    Args:
        name: one of BACKENDS.
        width: 1.0, 0.5 or 0.25.
        threads: of the processor; see the classes.

    Raises:
        SpecError: no such back end (a ValueError).
        BackendError: it is not installed, or needs a graphics card that is not there.
        WeightsError: no such weights.
    """
    check_choice("backend", name, BACKENDS)
    if name in ("torch", "torch-cuda"):
        return TorchBackend(width, threads=threads, device="cpu" if name == "torch" else "cuda")
    return make_exported_backend(name, weights_path(width, "onnx"), threads)


def make_exported_backend(name: str, path: str | Path, threads: int | None = None) -> Backend:
    """A back end over an exported file.

    Args:
        name: one of EXPORTED_BACKENDS.
        path: what `perception.inference.weights.export_onnx` wrote.
        threads: of the processor; see the classes.

    Raises:
        SpecError: no such back end, or one that reads no exported files (a ValueError).
        BackendError: it is not installed, or needs a graphics card that is not there.
        WeightsError: the file is missing or no network of ours.
    """
    check_choice("backend", name, EXPORTED_BACKENDS)
    if name in GPU_BACKENDS:
        from perception.inference.graphics_card import PROVIDERS, GraphicsCardBackend

        return GraphicsCardBackend(path, PROVIDERS[name])
    return (OnnxBackend if name == "onnx" else OpenVinoBackend)(path=path, threads=threads)


def _check_threads(threads: int | None) -> int | None:
    if threads is not None and threads < 1:
        raise ValueError(f"threads={threads!r} must be at least 1, or None")
    return threads
