"""The page in a real browser: it draws, its controls act, Ctrl-C ends it. Needs viser, and chromium (Debian)."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from perception.sources.source import MissingExtraError
from policies.watch.page import WatchPage, block_table, check_address, load_viser, watch
from policies.watch.session import WatchConfig, WatchSession
from stair_env.observation import StairBlock

PATIENCE_S = 180.0  # a browser without a graphics card, on a busy machine
CHROMIUM_ARGUMENTS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def test_the_block_stands_beside_the_truth() -> None:
    truth = StairBlock(1.0, 1.0, 0.3, 0.15, 0.4, 0.0, 0.0, 1.0)._asdict()
    text = block_table(StairBlock(1.0, 1.0, 0.31, 0.14, 0.42, 0.01, 0.05, 0.9)._asdict(), truth)
    assert "| step width, m | 0.310 | 0.300 |" in text and "| confidence | 0.90 |  |" in text
    assert "| step width, m | – | 0.300 |" in block_table(StairBlock()._asdict(), truth)


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtraError, match=r"stair-env\[watch\]"):
        load_viser()


def test_an_address_in_use_is_refused() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(ValueError, match=r"choose another --port"):
            check_address("127.0.0.1", taken.getsockname()[1])
    with pytest.raises(ValueError, match=r"--host of this machine"):
        check_address("192.0.2.1", 0)  # of no machine (RFC 5737)


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[WatchSession, WatchPage]]:
    pytest.importorskip("viser", reason="the page needs the extra stair-env[watch]")
    session = WatchSession(WatchConfig(agent="zero", num_steps=3))
    page = WatchPage(session, port=0)
    yield session, page
    page.close()
    session.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="the browser is driven by playwright")
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("the page is looked at in Debian's chromium (apt-get install chromium)")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=chromium, args=list(CHROMIUM_ARGUMENTS))
        yield browser
        browser.close()


def until(page: WatchPage, true: Callable[[], bool]) -> None:
    """Obey what was pressed until something is true."""
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < deadline
        page.obey()
        time.sleep(0.05)


def shows_true_edges(tab: Any) -> bool:
    """Whether the scene, left of the controls, has something in it, and the green of the edges."""
    picture = cv2.imdecode(np.frombuffer(tab.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    scene = picture[:, :700].reshape(-1, 3).astype(int)
    green = (scene[:, 1] > scene[:, 0] + 40) & (scene[:, 1] > scene[:, 2] + 40)
    return bool(scene.std() > 10 and green.sum() > 50)


def test_the_page_shows_the_robot_and_its_controls_act(served: tuple[WatchSession, WatchPage], browser: Any) -> None:
    session, page = served
    tab = browser.new_page(viewport={"width": 1280, "height": 800})
    tab.set_default_timeout(1000 * PATIENCE_S)
    tab.goto(page.address)
    tab.get_by_role("button", name="Pause").click()
    until(page, lambda: session.paused)
    tab.get_by_role("button", name="Go on").click()
    until(page, lambda: not session.paused)
    watch(session, page, 12)
    assert session.steps == 12
    tab.get_by_text("step width, m").wait_for()
    tab.get_by_role("button", name="left").click()
    sideways = session.simulation.base_state().velocity[1]
    until(page, lambda: session.simulation.base_state().velocity[1] > sideways + 0.3)
    slider = tab.get_by_role("slider").first
    slider.focus()
    slider.press("ArrowRight")
    until(page, lambda: session.stairs.riser_height == pytest.approx(0.135))
    assert session.steps == 0
    page.show()
    until(page, lambda: shows_true_edges(tab))
    tab.close()


def test_ctrl_c_ends_it_cleanly() -> None:
    pytest.importorskip("viser", reason="the page needs the extra stair-env[watch]")
    script = """
import signal
from stair_env_cli.main import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs inherit one that ignores it
raise SystemExit(main(["watch", "--port", "0", "--agent", "zero"]))
"""
    running = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[3],
    )
    try:
        assert running.stdout is not None
        assert "watch at http://127.0.0.1:" in running.stdout.readline()
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=PATIENCE_S)
    finally:
        running.kill()
    assert running.returncode == 0, err
    assert out.startswith("0 of 0 flights climbed") and "Traceback" not in err
