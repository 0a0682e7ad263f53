"""What all chamber drivers check before a set point goes out, and after."""

from __future__ import annotations

from collections.abc import Callable

from gyrocal.bench.devices import ChamberLimits
from gyrocal.errors import DeviceError


def check_setpoint(name: str, temp_c: float, limits: ChamberLimits) -> None:
    """Refuse a set point outside the chamber's limits, deg C; nothing has been sent then."""
    if not limits.min_temp_c <= temp_c <= limits.max_temp_c:
        msg = (
            f"{name}: a set point of {temp_c:g} deg C is outside its limits "
            f"({limits.min_temp_c:g}..{limits.max_temp_c:g} deg C); nothing was sent."
        )
        raise DeviceError(msg)


def verify_setpoint(name: str, temp_c: float, read_back: Callable[[], float], resolution_c: float) -> None:
    """Refuse to go on when the chamber does not show the set point that it was given, deg C."""
    shown_c = read_back()
    if not abs(shown_c - temp_c) <= 0.51 * resolution_c:
        msg = f"{name}: was given a set point of {temp_c:g} deg C and shows {shown_c:g}. Check its mode, units and panel lock."
        raise DeviceError(msg)


def alarm_not_taken(name: str, given_c: float, shown_c: float) -> DeviceError:
    """The error of a chamber whose own alarm limit reads back as another, deg C."""
    return DeviceError(
        f"{name}: was given an alarm limit of {given_c:g} deg C and shows {shown_c:g}. Check its range, units and panel lock."
    )
