"""`stair-env watch`: the environment in a browser page, without a display."""

from __future__ import annotations

import argparse

from stair_env.common.constants import SCENE_LIGHTINGS, WALKING_DIRECTIONS, WATCHED_AGENTS
from stair_env_cli.arguments import add_common_arguments, limit_threads, positive_float, positive_int, write_json


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Declare the options."""
    parser = subparsers.add_parser(
        "watch",
        help="watch a robot climb in a browser page, and interfere",
        description="Serve a page with the robot on its stairs, what its camera sees, the stair block beside the "
        "truth, and controls: pause, reset, agent, a push, other stairs. Needs no display; Ctrl-C ends it.",
    )
    parser.add_argument("--robot", default="aliengo", help="robot (%(default)s)")
    parser.add_argument(
        "--agent", choices=WATCHED_AGENTS, default="policy", help="a policy, the gait alone, or chance (%(default)s)"
    )
    parser.add_argument("--policy", metavar="NAME|FILE", help="shipped name, folder or model.zip (the robot's name)")
    parser.add_argument("--direction", choices=WALKING_DIRECTIONS, default="up", help="(%(default)s)")
    parser.add_argument("--riser", type=positive_float, default=0.13, metavar="M", help="step height (%(default)s)")
    parser.add_argument("--tread", type=positive_float, default=0.30, metavar="M", help="step width (%(default)s)")
    parser.add_argument("--steps", type=positive_int, default=5, metavar="N", help="of the flight (%(default)s)")
    parser.add_argument("--lighting", choices=SCENE_LIGHTINGS, default="day", help="(%(default)s)")
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen at; 0.0.0.0 lets other machines in (%(default)s)"
    )
    parser.add_argument("--port", type=_port, default=8080, help="0 takes any that is free (%(default)s)")
    parser.add_argument("--control-steps", type=positive_int, metavar="N", help="stop after N of 1/48 s (never)")
    add_common_arguments(parser)


def _port(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = -1
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no port: a whole number from 0 to 65535")
    return value


def run(args: argparse.Namespace) -> int:
    """Serve the page until interrupted; then say how the flights went."""
    limit_threads(1)
    from policies.watch.page import WatchPage, load_viser, watch
    from policies.watch.session import WatchConfig, WatchSession

    load_viser()  # a missing library is told before a simulation is opened
    config = WatchConfig(
        robot=args.robot,
        agent=args.agent,
        policy=args.policy,
        direction=args.direction,
        riser_height=args.riser,
        tread_depth=args.tread,
        num_steps=args.steps,
        lighting=args.lighting,
        seed=args.seed,
    )
    session = WatchSession(config)
    try:
        page = WatchPage(session, args.host, args.port)
        try:
            print(f"watch at {page.address} (Ctrl-C ends it)", flush=True)
            watch(session, page, args.control_steps)
        except KeyboardInterrupt:  # how one ends it
            pass
        finally:
            page.close()
    finally:
        session.close()
    arrived = sum(flight["success"] for flight in session.flights)
    print(f"{arrived} of {len(session.flights)} flights climbed")
    if args.json:
        write_json(args.json, {"flights": session.flights}, seed=args.seed)
    return 0
