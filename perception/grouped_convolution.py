"""The network's 3 x 3 grouped convolution, compiled for training on a processor.

torch computes groups of two or four channels either slowly (grouped) or with eight to thirty-two times the arithmetic
that is needed (dense, zero between the groups). Here a row of the result is a sum of scaled rows, which a processor
adds many numbers at a time. Padding, results and gradients are those of `torch.nn.functional.conv2d`.

Importing this module loads numba: do so when a network is trained, not at the top of a module.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from stair_env.common.compiling import njit

T = TypeVar("T")


def grouped_convolution(
    x: Tensor, weight: Tensor, bias: Tensor | None, stride: int, dilation: tuple[int, int]
) -> Tensor:
    """A 3 x 3 grouped convolution with as many channels out as in, padded by its dilation.

    As many threads work at it as torch may use, each on some of the images.

    Args:
        x: (B, C, H, W) float32 on the processor.
        weight: (C, C / groups, 3, 3) float32.
        bias: (C,) float32, or None.
        stride: of both axes.
        dilation: rows, columns.

    Returns:
        (B, C, ceil(H / stride), ceil(W / stride)) float32.
    """
    result: Tensor = _GroupedConvolution.apply(x, weight, bias, stride, dilation)
    return result


class _GroupedConvolution(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None, stride: int, dilation: tuple[int, int]
    ) -> Tensor:
        x, weight = x.detach().contiguous(), weight.detach().contiguous()
        ctx.save_for_backward(x, weight)
        ctx.stride, ctx.dilation = stride, dilation
        out = x.new_empty(*x.shape[:2], *((side - 1) // stride + 1 for side in x.shape[2:]))
        start = np.zeros(len(weight), np.float32) if bias is None else bias.detach().numpy()
        images, results, kernel = x.numpy(), out.numpy(), weight.numpy()
        _in_parts(len(x), lambda part: _convolve(images[part], kernel, start, stride, *dilation, results[part]))
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, Tensor | None, Tensor | None, None, None]:
        x, weight = ctx.saved_tensors
        stride, dilation = ctx.stride, ctx.dilation
        grad = grads[0].contiguous()
        to_x = to_weight = to_bias = None
        images, slopes, kernel = x.numpy(), grad.numpy(), weight.numpy()
        if ctx.needs_input_grad[0]:
            to_x = torch.empty_like(x)
            into = to_x.numpy()
            if stride == 1:  # the same with every kernel turned by 180 degrees, and inputs and outputs changed over
                size = weight.shape[1]
                turned = weight.view(-1, size, size, 3, 3).transpose(1, 2).flip(3, 4).reshape(weight.shape).numpy()
                none = np.zeros(len(weight), np.float32)
                _in_parts(len(x), lambda part: _convolve(slopes[part], turned, none, 1, *dilation, into[part]))
            else:
                _in_parts(len(x), lambda part: _spread_back(slopes[part], kernel, stride, *dilation, into[part]))
        if ctx.needs_input_grad[1]:
            sums = _in_parts(
                len(x), lambda part: _weight_slope(images[part], slopes[part], kernel.shape[1], stride, *dilation)
            )
            to_weight = torch.from_numpy(np.sum(sums, axis=0))
        if ctx.needs_input_grad[2]:
            to_bias = grad.sum((0, 2, 3))
        return to_x, to_weight, to_bias, None, None


def _in_parts(images: int, work: Callable[[slice], T]) -> list[T]:
    """Do some work on every image, in as many threads as torch may use."""
    threads = min(torch.get_num_threads(), images)
    if threads == 1:
        return [work(slice(0, images))]
    ends = np.linspace(0, images, threads + 1).astype(int).tolist()
    return list(_pool().map(work, [slice(a, b) for a, b in pairwise(ends)]))


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="grouped-convolution")


# Below, `planes` are a group's channels padded by the dilation, (stride, channels, rows, columns / stride): columns are
# dealt out by their remainder, so that a kernel's tap reads neighbouring numbers whatever the stride.


@njit(cache=True, nogil=True, error_model="numpy")
def _layout(
    size: int, height: int, width: int, stride: int, rows: int, columns: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Empty planes of a group, and the plane and its first column that each of a kernel row's three taps reads."""
    planes = np.zeros((stride, size, height + 2 * rows, width // stride + 2 * columns + 1), np.float32)
    offsets = columns * np.arange(3)
    return planes, offsets % stride, offsets // stride


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(x: np.ndarray, stride: int, rows: int, columns: int, planes: np.ndarray) -> None:
    """A group's channels (C / groups, H, W) to planes."""
    channels, height, width = x.shape
    for i in range(channels):
        for y in range(height):
            for phase in range(stride):
                first = (phase - columns) % stride
                line, start = x[i, y, first:], (first + columns) // stride
                into = planes[phase, i, y + rows, start : start + (width - first + stride - 1) // stride]
                if stride == 1:
                    for k in range(len(into)):
                        into[k] = line[k]
                elif stride == 2:  # a number that the compiler knows
                    for k in range(len(into)):
                        into[k] = line[2 * k]
                else:
                    for k in range(len(into)):
                        into[k] = line[stride * k]


@njit(cache=True, nogil=True, error_model="numpy")
def _empty(planes: np.ndarray, stride: int, rows: int, columns: int, x: np.ndarray) -> None:
    """Planes back to a group's channels (C / groups, H, W)."""
    channels, height, width = x.shape
    for i in range(channels):
        for y in range(height):
            for phase in range(stride):
                first = (phase - columns) % stride
                line, start = x[i, y, first:], (first + columns) // stride
                source = planes[phase, i, y + rows, start : start + (width - first + stride - 1) // stride]
                if stride == 2:  # a number that the compiler knows
                    for k in range(len(source)):
                        line[2 * k] = source[k]
                else:
                    for k in range(len(source)):
                        line[stride * k] = source[k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _convolve(
    x: np.ndarray, weight: np.ndarray, bias: np.ndarray, stride: int, rows: int, columns: int, out: np.ndarray
) -> None:
    """x (B, C, H, W) to out (B, C, H / stride, W / stride)."""
    images, channels, height, width = x.shape
    size, out_height, out_width = weight.shape[1], out.shape[2], out.shape[3]
    planes, phase, start = _layout(size, height, width, stride, rows, columns)
    for n in range(images):
        for first in range(0, channels, size):
            _fill(x[n, first : first + size], stride, rows, columns, planes)
            for y in range(out_height):
                for o in range(first, first + size):
                    row = out[n, o, y]
                    row[:] = bias[o]
                    for i in range(size):
                        for tap in range(3):
                            at = y * stride + tap * rows
                            left = planes[phase[0], i, at, start[0] : start[0] + out_width]
                            middle = planes[phase[1], i, at, start[1] : start[1] + out_width]
                            right = planes[phase[2], i, at, start[2] : start[2] + out_width]
                            a, b, c = weight[o, i, tap, 0], weight[o, i, tap, 1], weight[o, i, tap, 2]
                            for k in range(out_width):
                                row[k] += a * left[k] + b * middle[k] + c * right[k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _weight_slope(x: np.ndarray, slope: np.ndarray, size: int, stride: int, rows: int, columns: int) -> np.ndarray:
    """Gradient of the weight, (C, C / groups, 3, 3), from that of the result."""
    images, channels, height, width = x.shape
    out_height, out_width = slope.shape[2], slope.shape[3]
    planes, phase, start = _layout(size, height, width, stride, rows, columns)
    total = np.zeros((channels, size, 3, 3), np.float32)
    for n in range(images):
        for first in range(0, channels, size):
            _fill(x[n, first : first + size], stride, rows, columns, planes)
            for o in range(first, first + size):
                for y in range(out_height):
                    row = slope[n, o, y]
                    for i in range(size):
                        for tap in range(3):
                            at = y * stride + tap * rows
                            left = planes[phase[0], i, at, start[0] : start[0] + out_width]
                            middle = planes[phase[1], i, at, start[1] : start[1] + out_width]
                            right = planes[phase[2], i, at, start[2] : start[2] + out_width]
                            a = b = c = np.float32(0.0)
                            for k in range(out_width):
                                a += row[k] * left[k]
                                b += row[k] * middle[k]
                                c += row[k] * right[k]
                            total[o, i, tap, 0] += a
                            total[o, i, tap, 1] += b
                            total[o, i, tap, 2] += c
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _spread_back(slope: np.ndarray, weight: np.ndarray, stride: int, rows: int, columns: int, out: np.ndarray) -> None:
    """Gradient of the input, as out (B, C, H, W), from that of the result."""
    images, channels, height, width = out.shape
    size, out_height, out_width = weight.shape[1], slope.shape[2], slope.shape[3]
    planes, phase, begin = _layout(size, height, width, stride, rows, columns)
    for n in range(images):
        for first in range(0, channels, size):
            planes[:] = 0.0
            for o in range(first, first + size):
                for y in range(out_height):
                    row = slope[n, o, y]
                    for i in range(size):
                        for tap in range(9):
                            down, along = tap // 3, tap % 3
                            at, start = y * stride + down * rows, begin[along]
                            into = planes[phase[along], i, at, start : start + out_width]
                            factor = weight[o, i, down, along]
                            for k in range(out_width):
                                into[k] += factor * row[k]
            _empty(planes, stride, rows, columns, out[n, first : first + size])
