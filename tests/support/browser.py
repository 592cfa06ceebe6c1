"""A headless Chromium for tests of pages: the distribution's, driven by Playwright. Without it such tests skip, in CI they fail.

What a page says on its console as an error, an exception that nothing catches and a request for anything that is not on this computer
all become lines of `console_errors`; a test that leaves such a line fails.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = ("chromium", "chromium-browser", "google-chrome")
WIDTHS = {"wide": 1400, "narrow": 400}
HERE = ("", "localhost", "127.0.0.1", "::1")
SWITCHES = (
    "--no-sandbox",  # root has none, as in CI
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE localhost, EXCLUDE 127.0.0.1",
)


def lacking() -> str:
    """What there is not on this computer; "" where a browser can be started."""
    try:
        import playwright.sync_api  # noqa: F401
    except ImportError:
        return "playwright is not installed"
    return "" if any(map(shutil.which, NAMES)) else f"no {NAMES[0]} on this computer (apt-get install {NAMES[0]})"


def browser_or_skip() -> None:
    """Skip the test where there is no browser; fail in CI, which installs one."""
    if missing := lacking():
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)


@contextmanager
def chromium() -> Iterator[Browser]:
    """A headless browser, closed at the end."""
    from playwright.sync_api import sync_playwright

    path = next(found for name in NAMES if (found := shutil.which(name)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(SWITCHES))
        try:
            yield browser
        finally:
            browser.close()


def listen(page: Page, errors: list[str]) -> None:
    """Add to `errors` what goes wrong on a page, from now on."""
    page.on("console", lambda said: errors.append(f"console: {said.text}") if said.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(f"exception: {error}"))
    page.on("request", lambda asked: None if is_here(asked.url) else errors.append(f"asked for {asked.url}"))


def is_here(url: str) -> bool:
    """Whether a request stays on this computer."""
    parts = urlsplit(url)
    return parts.scheme in ("data", "blob", "about", "file") or (parts.hostname or "") in HERE


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One browser for the tests of a file; no longer, because no other event loop can run in its thread meanwhile."""
    browser_or_skip()
    with chromium() as started:
        yield started


@pytest.fixture
def console_errors() -> Iterator[list[str]]:
    """What went wrong on the test's pages; a test that provokes a line takes it out."""
    errors: list[str] = []
    yield errors
    assert errors == []


@pytest.fixture
def page(browser: Browser, console_errors: list[str]) -> Iterator[Page]:
    """A fresh page, 1400 px wide; `page.set_viewport_size` makes it narrow."""
    context = browser.new_context(viewport={"width": WIDTHS["wide"], "height": 900})
    opened = context.new_page()
    listen(opened, console_errors)
    yield opened
    context.close()
