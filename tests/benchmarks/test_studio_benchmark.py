"""A short run of the benchmark of the page: ten users, and a monkey that finds nothing."""

import os
import shutil

import pytest

from benchmarks import studio


@pytest.mark.slow
def test_ten_users_and_a_short_monkey() -> None:
    if shutil.which("chromium") is None:
        assert not os.environ.get("TARC_REQUIRE_BROWSER"), "needs chromium: TARC_REQUIRE_BROWSER is set"
        pytest.skip("needs chromium")
    with studio.serving() as server, studio.browsing() as browser:
        pages = [studio.open_page(browser, server.url)]
        first = server.memory()
        pages += [studio.open_page(browser, server.url) for _ in range(9)]
        assert (server.memory() - first) / 9 < 200
        times = [*studio.latencies(pages[0], ".numbers", 2), *studio.latencies(pages[0], ".measures", 1)]
        assert max(times) < 20  # each move reaches the page; `python -m benchmarks.studio` measures how fast
        for page in pages[1:]:
            page.close()
        report = studio.monkey(pages[0], server, 40)
        assert not report.errors
        assert not server.failures()
