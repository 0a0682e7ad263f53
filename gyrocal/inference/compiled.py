"""Loops that numba compiles where it is installed; without it the same functions run as they are, slower."""

from __future__ import annotations

from typing import Any

try:
    from numba import njit
except ImportError:

    def njit(*_: Any, **__: Any) -> Any:  # type: ignore[no-redef]
        """Leave a function as it is."""
        return lambda function: function


__all__ = ["njit"]
