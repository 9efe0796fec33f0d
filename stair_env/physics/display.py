"""Whether a window can be opened, asked before Bullet is: it ends the whole process where its window cannot open."""

from __future__ import annotations

import os
import subprocess
import sys

ANSWER_S = 5.0  # a server that accepts connections and never answers would be waited for without end
_ASK = """
import ctypes
x11 = ctypes.CDLL("libX11.so.6")
x11.XOpenDisplay.restype = ctypes.c_void_p
display = x11.XOpenDisplay(None)
if not display:
    raise SystemExit("nobody serves it, or access was refused")
numbers = [ctypes.byref(ctypes.c_int()) for _ in range(3)]
if not x11.XQueryExtension(ctypes.c_void_p(display), b"GLX", *numbers):
    raise SystemExit("it offers no OpenGL")
"""


def display_problem() -> str | None:
    """Why no window can be opened, or None when one can."""
    if sys.platform != "linux":
        return None
    name = os.environ.get("DISPLAY")
    if not name:
        return "DISPLAY is not set"
    try:  # in a process of its own: Xlib, too, may wait for ever
        asked = subprocess.run(
            [sys.executable, "-S", "-E", "-c", _ASK], capture_output=True, text=True, timeout=ANSWER_S, check=False
        )
    except subprocess.TimeoutExpired:
        return f"DISPLAY={name}: no answer for {ANSWER_S:g} s"
    except OSError as error:
        return f"DISPLAY={name}: {error}"
    if asked.returncode == 0:
        return None
    said = asked.stderr.strip().splitlines()
    return f"DISPLAY={name}: {said[-1] if said else 'the display cannot be opened'}"
