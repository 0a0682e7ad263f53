"""What other installed packages add to gyrocal: objects that their entry points name."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import TypeVar

from gyrocal.errors import InputError

T = TypeVar("T")


def extended(group: str, kind: type[T], own: dict[str, T]) -> dict[str, T]:
    """`own`, and what the entry points of `group` add to it, by name.

    Raises
    ------
    InputError
        An entry point cannot be loaded, is not of this kind, or takes a name that is taken.
    """
    found = dict(own)
    for entry in sorted(entry_points(group=group)):
        package = entry.dist.name if entry.dist is not None else "unknown"
        says = f"The package {package} extends gyrocal by {group}: {entry.name} = {entry.value}, and"
        remedy = f"Repair, update or uninstall {package}."
        try:
            added = entry.load()
        except Exception as error:
            raise InputError(f"{says} that cannot be loaded ({error}). {remedy}") from error
        if not isinstance(added, kind):
            raise InputError(f"{says} that is a {type(added).__name__}, not a {kind.__name__}. {remedy}")
        if entry.name in found:
            raise InputError(f"{says} there is one of that name already. {remedy}")
        found[entry.name] = added
    return found
