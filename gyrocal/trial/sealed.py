"""What is written down before an answer is known, so that nobody can change it after."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Sealed:
    """An answer that is committed to by its hash; whoever extends it adds a nonce, so that it cannot be guessed."""

    def text(self) -> str:
        """Canonical JSON: what is hashed."""
        return json.dumps(asdict(self), sort_keys=True, separators=(",", ":"), allow_nan=False)

    def seal(self) -> str:
        """The commitment: sha256 of the canonical text."""
        return hashlib.sha256(self.text().encode()).hexdigest()

    def check(self, number: int, commitment: str) -> None:
        """Compare with what trial `number` committed to.

        Raises
        ------
        ValueError
            It is another answer.
        """
        if self.seal() != commitment:
            msg = f"trial {number}: what was opened is not what was sealed"
            raise ValueError(msg)
