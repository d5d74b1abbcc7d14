"""What the tests of pages share."""

from collections.abc import Iterator

import pytest

from browsing import open_browser


@pytest.fixture(scope="session")
def browser() -> Iterator[object]:
    with open_browser() as opened:
        yield opened
