"""No loop of the bench waits for a device, or for time, without an end that is written beside it: read from the source."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import gyrocal.bench

PACKAGE = Path(gyrocal.bench.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

#: Calls that wait, by their last name: for bytes, for an answer, for a thread, for time.
WAITING = {
    "read_available",
    "read",
    "ask",
    "_ask",
    "_exchange",
    "look",
    "sleep",
    "join",
    "wait",
    "recv",
    "_record_until",
    "_record_slowly",
    "_prompt",
    "prompt",
    "start",
    "_start_again",
}
#: Words of a condition that ends a wait: a deadline, or that somebody wants it to end.
ENDS = ("deadline_s", "until_s", "end_s", "left_s", "is_set", "duration_s", ".wait(")
#: Loops that wait for the operator: a signal ends the question.
OF_THE_OPERATOR = {("manual.py", "_confirm_rate"), ("manual.py", "_number")}


def calls(node: ast.AST) -> Iterator[str]:
    """Last names of everything that is called within."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.Call):
            if isinstance(inner.func, ast.Attribute):
                yield inner.func.attr
            elif isinstance(inner.func, ast.Name):
                yield inner.func.id


def leaves(body: list[ast.stmt]) -> bool:
    """Whether a branch leaves the loop, by all that its statements say."""
    return any(isinstance(inner, ast.Break | ast.Return | ast.Raise) for s in body for inner in ast.walk(s))


def ends_of(loop: ast.While) -> Iterator[str]:
    """Conditions under which a loop ends: its own, and those of branches that leave it."""
    yield ast.unparse(loop.test)
    for inner in ast.walk(loop):
        if isinstance(inner, ast.If) and leaves(inner.body):
            yield ast.unparse(inner.test)


def endless(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Functions and lines of loops that wait without an end."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        for loop in ast.walk(function):
            if isinstance(loop, ast.While) and WAITING & set(calls(loop)):
                said = " ".join(ends_of(loop))
                if not any(word in said for word in ENDS):
                    yield function.name, loop.lineno


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_no_loop_waits_without_a_deadline(path: Path) -> None:
    found = endless(ast.parse(path.read_text(encoding="utf-8")))
    assert [where for where in found if (path.name, where[0]) not in OF_THE_OPERATOR] == []


def test_such_loops_are_found() -> None:
    loops = """
def clear(self):
    while self.read_available(0.0):
        pass
def ask(self):
    answer = self.talk.ask(b"")
    while answer.startswith(b"#"):
        answer = self.talk.ask(b"")
def bounded(self):
    while True:
        data = self.read_available(0.1)
        if data or self.now_s() > deadline_s:
            return data
"""
    assert list(endless(ast.parse(loops))) == [("clear", 3), ("ask", 7)]
