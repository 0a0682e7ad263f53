"""Certificates of the instruments that a run was measured with, and whether they were still valid then."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from typing import Any

#: Instruments of a bench whose certificates a run may name, as ``table_certificate`` and ``table_due``.
INSTRUMENTS = ("table", "thermometer")


def expired(identity: Mapping[str, Any], on: date) -> tuple[str, ...]:
    """Sentences, without a full stop, on certificates whose due date was before the day `on`.

    Parameters
    ----------
    identity : entry ``identity`` of ``run.json``
        Texts that are no dates, as after an edit by hand, say nothing.
    """
    said = []
    for instrument in INSTRUMENTS:
        due = day_of(identity.get(f"{instrument}_due"))
        if due is not None and due < on:
            number = identity.get(f"{instrument}_certificate")
            name = f"certificate {number}" if number else "certificate"
            said.append(f"the {instrument}'s {name} expired on {due.isoformat()}")
    return tuple(said)


def day_of(text: Any) -> date | None:
    """Day of a date or of an instant as ISO 8601 writes it; None where it is neither."""
    try:
        return date.fromisoformat(str(text)[:10])
    except ValueError:
        return None
