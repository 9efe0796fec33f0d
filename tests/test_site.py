"""The built pages in a headless browser, as `make docs` runs it: every page of the menu opens, whole and faultless."""

import functools
import http.server
import os
import shutil
import threading
from pathlib import Path

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="pip install 'stair-env[docs]'")
SITE = Path(__file__).resolve().parents[1] / "build" / "site"
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not SITE.is_dir(), reason="`make docs` builds the pages"),
    pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium"),
]


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *args):
        pass


@pytest.fixture(scope="module")
def address():
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=str(SITE)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


@pytest.fixture(scope="module")
def page():
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser.new_page(viewport={"width": 1280, "height": 900})
        browser.close()


def test_every_page_of_the_menu_opens_whole(address, page, tmp_path):
    failed = []
    page.on("requestfailed", lambda request: failed.append(request.url))
    page.on("response", lambda response: failed.append(response.url) if response.status >= 400 else None)
    page.on("pageerror", lambda error: failed.append(str(error)))
    page.on("request", lambda r: failed.append(f"elsewhere: {r.url}") if not r.url.startswith(address) else None)
    page.goto(address)
    links = page.eval_on_selector_all("nav.md-nav--primary a.md-nav__link", "all => all.map(a => a.href)")
    pages = list(dict.fromkeys(link.split("#")[0] for link in links))
    assert len(pages) > 20
    shots = Path(os.environ.get("SITE_SCREENSHOTS", tmp_path))
    for number, link in enumerate(pages):
        page.goto(link)
        assert page.locator("article h1").first.inner_text().strip()
        broken = page.eval_on_selector_all("article img", "all => all.filter(i => !i.naturalWidth).map(i => i.src)")
        assert not broken, (link, broken)
        page.screenshot(path=str(shots / f"{number:02d}.png"))
    assert not failed


def test_search_finds_the_camera(address, page):
    page.goto(address)
    page.locator("input.md-search__input").fill("speckle")
    page.wait_for_selector(".md-search-result__item", timeout=20_000)
    page.locator(".md-search-result__item a").first.click()
    page.wait_for_load_state()
    assert page.locator("article h1").first.inner_text().strip()
