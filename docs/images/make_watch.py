"""Draws docs/images/watch.jpg, the page of `stair-env watch`: needs Debian's chromium, and playwright."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
from playwright.sync_api import sync_playwright

from policies.watch.page import WatchPage, watch
from policies.watch.session import WatchConfig, WatchSession

CONTROL_STEPS = 96  # two seconds: the robot is on the first steps
DRAWING_S = 8.0  # of a browser without a graphics card
ARGUMENTS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def main() -> None:
    """Let the robot climb for two seconds, and take a picture of the page."""
    session = WatchSession(WatchConfig())
    page = WatchPage(session, port=0)
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=shutil.which("chromium"), args=list(ARGUMENTS))
        tab = browser.new_page(viewport={"width": 1400, "height": 1000})
        tab.set_default_timeout(120_000)
        tab.goto(page.address)
        tab.get_by_role("button", name="Pause").wait_for()
        watch(session, page, CONTROL_STEPS)
        session.paused = True
        page.show()
        for note in tab.locator(".mantine-Notification-closeButton").all():  # that there is no graphics card
            note.click()
        tab.wait_for_timeout(1000 * DRAWING_S)
        picture = cv2.imdecode(np.frombuffer(tab.screenshot(), np.uint8), cv2.IMREAD_COLOR)
        browser.close()
    page.close()
    session.close()
    assert picture is not None
    cv2.imwrite(str(Path(__file__).with_name("watch.jpg")), picture, [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
