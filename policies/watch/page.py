"""A session in a browser page, by viser (`stair-env[watch]`): the robot on its stairs, what it sees, and controls."""

from __future__ import annotations

import contextlib
import io
import queue
import socket
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from perception.sources.source import MissingExtraError
from policies.report.camera_view import camera_view
from policies.report.flight_log import MEASURED, TRUE
from policies.watch.session import PUSHES, WatchSession
from stair_env.common.constants import (
    CONTROL_DT,
    RISER_RANGE_M,
    STEP_COUNT_RANGE,
    TREAD_RANGE_M,
    WALKING_DIRECTIONS,
)
from stair_env.physics.simulation import SHAPE_COLOURS
from stair_env.physics.visual_parts import Pose, VisualPart, link_poses, visual_parts
from stair_env.scene.shapes import build_stair_shapes

DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 8080
SHOW_EVERY = 2  # control steps
PICTURE_STRIDE = 2  # pixels of the camera's picture between those that travel to the page
SETTLE_S = 0.4  # for which a slider must rest before its stairs are built
FRUSTUM_M = 0.25
SIZES = ("step_width", "step_height", "edge_distance", "heading_error")


def load_viser() -> Any:
    """The module viser.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingExtraError(f"watch needs viser ({error}): pip install 'stair-env[watch]'") from None
    return viser


class WatchPage:
    """Shows a session, and hands over what is pressed.

    Nothing of the session is touched from the server's threads: what is pressed waits until `obey`.

    Args:
        session: that is watched.
        host: address to listen at; "0.0.0.0" lets other machines in.
        port: 0 takes any that is free.

    Raises:
        MissingExtraError: viser is not installed.
        ValueError: the address cannot be listened at.
    """

    def __init__(self, session: WatchSession, host: str = DEFAULT_HOST, port: int = DEFAULT_PORT) -> None:
        viser = load_viser()
        check_address(host, port)
        self._session = session
        self._pressed: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._stairs_due_s: float | None = None
        self._shown_stairs: Any = None
        self._solids: Any = None
        self._drawn: dict[str, Any] = {}
        self._shown_picture: Any = None
        self._clock: list[tuple[float, float]] = []  # wall and simulated seconds of the last shows
        with _silence():
            self._server = viser.ViserServer(host, port, label="stair_env", verbose=False)
        self._open = True
        self._server.initial_camera.position = (-0.6, -1.7, 1.2)
        self._server.initial_camera.look_at = (0.45, 0.0, 0.3)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)  # sharing asks a foreign server
        self._controls()
        self._robot()
        self.show()

    @property
    def address(self) -> str:
        """Of the page."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    # ------------------------------------------------------------------ controls

    def _controls(self) -> None:
        gui, session = self._server.gui, self._session
        self._status = gui.add_markdown("")
        self._pause = gui.add_button("Pause")
        self._when(self._pause, lambda: setattr(session, "paused", not session.paused))
        self._when(gui.add_button("Reset"), session.restart)
        self._agent = gui.add_dropdown("Agent", session.agents, initial_value=session.agent)
        self._when(self._agent, lambda: session.choose(self._agent.value))
        push = gui.add_button_group("Push", tuple(PUSHES))
        self._when(push, lambda: session.push(push.value))
        stairs = session.stairs
        with gui.add_folder("Stairs"):
            self._direction = gui.add_dropdown("Direction", WALKING_DIRECTIONS, initial_value=stairs.direction)
            self._riser = gui.add_slider("Riser, m", *RISER_RANGE_M, 0.005, stairs.riser_height)
            self._tread = gui.add_slider("Tread, m", *TREAD_RANGE_M, 0.005, stairs.tread_depth)
            self._count = gui.add_slider("Steps", *STEP_COUNT_RANGE, 1, stairs.num_steps)
        for control in (self._direction, self._riser, self._tread, self._count):
            self._when(control, self._want_stairs)
        with gui.add_folder("What it sees"):
            self._picture = gui.add_image(
                np.zeros((240, 320, 3), np.uint8), label="Camera, with lines", jpeg_quality=75
            )
            self._block = gui.add_markdown("")
        with gui.add_folder("Reward", expand_by_default=False):
            self._rewards = gui.add_markdown("")

    def _when(self, control: Any, act: Callable[[], Any]) -> None:
        """Let the loop act once the control is used."""
        register = control.on_click if hasattr(control, "on_click") else control.on_update
        register(lambda _: self._pressed.put(act))

    def _want_stairs(self) -> None:
        self._stairs_due_s = time.monotonic() + SETTLE_S

    def obey(self) -> None:
        """Do what was pressed since the last call."""
        while not self._pressed.empty():
            self._pressed.get()()
            self._pause.label = "Go on" if self._session.paused else "Pause"
        if self._stairs_due_s is not None and time.monotonic() >= self._stairs_due_s:
            self._stairs_due_s = None
            self._session.restart(
                direction=self._direction.value,
                riser_height=float(self._riser.value),
                tread_depth=float(self._tread.value),
                num_steps=int(self._count.value),
                riser_offsets=(),
                tread_offsets=(),
            )

    # ------------------------------------------------------------------ scene

    def _robot(self) -> None:
        """Each link's drawn parts under a frame that moves."""
        scene, simulation = self._server.scene, self._session.simulation
        self._links: dict[int, Any] = {}
        for number, part in enumerate(visual_parts(simulation.client, simulation.body)):
            name = f"/robot/link_{part.link + 1}"
            if part.link not in self._links:
                self._links[part.link] = scene.add_frame(name, show_axes=False)
            _add_part(scene, f"{name}/part_{number}", part)
        model = self._session.env.get_wrapper_attr("camera_intrinsics")
        self._frustum = scene.add_camera_frustum(
            "/camera",
            fov=2.0 * float(np.arctan(model.height / (2.0 * model.fy))),
            aspect=model.width / model.height,
            scale=FRUSTUM_M,
            thickness=0.006,
            color=(40, 90, 200),
        )

    def _stairs(self) -> None:
        """Solids and true edges; built anew for other stairs."""
        if self._shown_stairs is self._session.stairs:
            return
        self._shown_stairs = self._session.stairs
        scene = self._server.scene
        if self._solids is not None:
            self._solids.remove()  # and all that is under it
        self._solids = scene.add_frame("/stairs", show_axes=False)
        for number, shape in enumerate(build_stair_shapes(self._shown_stairs)):
            size = tuple(2.0 * length for length in shape.size)  # a plain staircase is all boxes
            colour = tuple(round(255 * part) for part in SHAPE_COLOURS[shape.surface][:3])
            scene.add_box(f"/stairs/{number}_{shape.surface}", colour, size, position=shape.position)
        self._lines("/true_edges", self._session.true_edges(), TRUE, 0.012)

    def _lines(self, name: str, lines: Sequence[np.ndarray], colour: Sequence[int], thickness: float) -> None:
        """Draw polylines, each (n, 3), in place of those of this name."""
        pairs = [line[i : i + 2] for line in lines for i in range(len(line) - 1)]
        points = np.array(pairs, np.float32).reshape(-1, 2, 3)
        if not len(points):  # something has to be there: a line of no length
            points = np.zeros((1, 2, 3), np.float32)
        if name in self._drawn:
            self._drawn[name].points = points
        else:
            self._drawn[name] = self._server.scene.add_line_segments(name, points, tuple(colour), thickness=thickness)

    def show(self) -> None:
        """Bring the page in line with the session."""
        session, simulation = self._session, self._session.simulation
        with self._server.atomic():
            self._stairs()
            for link, pose in link_poses(simulation.client, simulation.body).items():
                if link in self._links:
                    _place(self._links[link], pose)
            self._camera()
            self._lines("/measured_next_edge", session.measured_edge(), MEASURED, 0.02)
            self._figures()

    def _camera(self) -> None:
        from scipy.spatial.transform import Rotation

        session = self._session
        pose = session.camera_to_world
        _place(self._frustum, (tuple(pose[:3, 3]), tuple(Rotation.from_matrix(pose[:3, :3]).as_quat())))
        seen = session.info["camera"]["frame"], id(session.stairs), len(session.flights)
        if seen == self._shown_picture:
            return
        self._shown_picture = seen
        picture = camera_view(session.env)
        if picture is not None:
            self._picture.image = picture[::PICTURE_STRIDE, ::PICTURE_STRIDE]
            self._frustum.image = picture[:: 2 * PICTURE_STRIDE, :: 2 * PICTURE_STRIDE]
        self._lines("/measured_stairs", session.measured_stairs(), MEASURED, 0.012)

    def _figures(self) -> None:
        session = self._session
        info, stairs = session.info, session.stairs
        state = session.outcome or ("paused" if session.paused else f"{self._pace():.2f}× real time")
        arrived = sum(flight["success"] for flight in session.flights)
        self._status.content = (
            f"**{session.config.robot}**, {stairs.direction}: step {info['steps_climbed']} of {stairs.num_steps}, "
            f"{session.time_s:.1f} s, {state.replace('_', ' ')}  \n{arrived} of {len(session.flights)} flights climbed"
        )
        self._block.content = block_table(session.block(), info["truth"])
        self._rewards.content = table(
            ("term", "value"), [(name, f"{value:+.4f}") for name, value in info["reward_terms"].items()]
        )

    def _pace(self) -> float:
        """Simulated seconds a second, over the last shows of this flight."""
        now, time_s = time.monotonic(), self._session.time_s
        if self._clock and time_s < self._clock[-1][1]:
            self._clock.clear()
        self._clock = [*self._clock[-20:], (now, time_s)]
        (before, began), elapsed = self._clock[0], now - self._clock[0][0]
        return (time_s - began) / elapsed if elapsed > 0 and now > before else 0.0

    def close(self) -> None:
        """Stop listening; safe to call twice."""
        if self._open:
            self._open = False
            with _silence():
                self._server.stop()


def _silence() -> contextlib.AbstractContextManager[Any]:
    """Keep viser's banner and farewell from standard output, which is the command's."""
    return contextlib.redirect_stdout(io.StringIO())


def watch(session: WatchSession, page: WatchPage, control_steps: int | None = None) -> None:
    """Let time pass, at most as fast as real time.

    Args:
        session: that goes on.
        page: that shows it.
        control_steps: after which to stop; None goes on until interrupted.
    """
    done = 0
    while control_steps is None or done < control_steps:
        start = time.monotonic()
        page.obey()
        session.advance()
        done += 1
        if done % SHOW_EVERY == 0:
            page.show()
        time.sleep(max(0.0, CONTROL_DT - (time.monotonic() - start)))


def check_address(host: str, port: int) -> None:
    """Refuse an address that cannot be listened at: viser would try a thousand ports in silence.

    Raises:
        ValueError: with the reason.
    """
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
    except (OSError, OverflowError) as error:
        raise ValueError(
            f"host={host!r}, port={port!r} cannot be listened at ({error}): choose another --port, 0 for any free one, "
            "and a --host of this machine (127.0.0.1; 0.0.0.0 lets other machines in)"
        ) from None


def block_table(block: Any, truth: Any) -> str:
    """The stair block beside the truth, in Markdown."""
    rows = []
    for name in SIZES:
        measured, true = (f"{values[name]:.3f}" if values["valid"] > 0.5 else "–" for values in (block, truth))
        unit = "rad" if name == "heading_error" else "m"
        rows.append((f"{name.replace('_', ' ')}, {unit}", measured, true))
    known = (f"{block[name]:.2f}" if block["valid"] > 0.5 else "–" for name in ("confidence", "age"))
    rows += [(name, value, "") for name, value in zip(("confidence", "age, s"), known)]
    return table(("block", "measured", "true"), rows)


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _place(handle: Any, pose: Pose) -> None:
    position, (x, y, z, w) = pose
    handle.position, handle.wxyz = position, (w, x, y, z)


def _add_part(scene: Any, name: str, part: VisualPart) -> None:
    position, (x, y, z, w) = part.part_to_link
    at: dict[str, Any] = {"position": position, "wxyz": (w, x, y, z)}
    colour = tuple(round(255 * channel) for channel in part.colour)
    if part.kind == "mesh":
        import trimesh

        loaded = trimesh.load(part.file)
        scene.add_mesh_trimesh(name, loaded, scale=part.size, **at)
    elif part.kind == "box":
        scene.add_box(name, colour, part.size, **at)
    elif part.kind == "sphere":
        scene.add_icosphere(name, part.size[0], colour, **at)
    else:
        scene.add_cylinder(name, part.size[1], part.size[0], colour, **at)
