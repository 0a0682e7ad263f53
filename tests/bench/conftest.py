"""Virtual runs need no durable disk: without fsync the tests of the bench take a third of the time."""

from __future__ import annotations

import os

import pytest


@pytest.fixture(autouse=True)
def _disk_is_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda fd: None)
