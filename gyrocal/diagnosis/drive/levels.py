"""What a law must gain for a name, and how improbable a pattern must be to be located."""

from __future__ import annotations

#: Twice the log likelihood that a law must gain to be named. On 100 drives with nothing hidden, made by another hand, no law
#: gained more than 11.4.
GAIN = 15.0
#: Chance at which columns of no name are located where there is nothing. Of 694 such tests on 64 drives of another hand without
#: any, two were below it.
STRANGER_P = 1e-3
