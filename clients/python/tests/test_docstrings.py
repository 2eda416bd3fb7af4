"""The examples in the docstrings."""

from __future__ import annotations

import doctest

from meshmend import operations


def test_the_examples_of_the_docstrings_run() -> None:
    result = doctest.testmod(operations, optionflags=doctest.IGNORE_EXCEPTION_DETAIL)
    assert result.attempted > 10 and result.failed == 0
