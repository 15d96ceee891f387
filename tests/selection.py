"""What the default run leaves to `pytest -m thorough`: the rest of a matrix, and what is long."""

import pytest

thorough = pytest.mark.thorough


def mostly_thorough(values, default):
    """Parameters of a test of which the default run takes those in `default` only."""
    values, default = list(values), list(default)
    unknown = [value for value in default if value not in values]
    assert not unknown, f"no such parameters: {unknown}"
    return [value if value in default else as_thorough(value) for value in values]


def as_thorough(value):
    """One parameter, or a tuple of them, that the default run leaves out."""
    values = value if isinstance(value, tuple) else (value,)
    return pytest.param(*values, marks=thorough)
