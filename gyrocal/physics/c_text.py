"""An effect's law as C, for the header that `gyrocal export` writes.

``@real@`` and ``@f@`` stand for the C type and the suffix of its functions, ``PREFIX`` for the caller's prefix; the
header's ``PREFIX_surface@f@(x, temp_c)`` is the error surface, ``@own@`` its own rate x at the true rate ``w`` (to
first order), and ``@turn@`` a minus where that is the true rate itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

#: Writes a number in the C type of the function.
Number = Callable[[float], str]


@dataclass(frozen=True)
class CMemory:
    """Time constants of temperatures and of heat (s) and half widths of plays (deg C) that the state keeps, in the order of their index."""

    tau_s: list[float] = field(default_factory=list)
    width_c: list[float] = field(default_factory=list)
    heat_tau_s: list[float] = field(default_factory=list)

    def lag(self, tau_s: float) -> str:
        """Expression for how far the temperature low-passed by `tau_s` is behind."""
        return f"(@real@)s->behind_c[{_place(self.tau_s, tau_s)}]"

    def play(self, width_c: float) -> str:
        """Expression for the position of a play of the half width `width_c`."""
        return f"s->play_c[{_place(self.width_c, width_c)}]"

    def heat(self, tau_s: float) -> str:
        """Expression for the squares of past rates low-passed by `tau_s`, deg^2/s^2."""
        return f"(@real@)s->heat_dps2[{_place(self.heat_tau_s, tau_s)}]"


def _place(known: list[float], value: float) -> int:
    if value not in known:
        known.append(value)
    return known.index(value)


@dataclass(frozen=True)
class CText:
    """C of an effect.

    Attributes
    ----------
    law : callable
        From parameters, number writer and memory to a C expression of ``w`` (rate, deg/s), ``temp_c``,
        ``since_power_on_s``, ``supply_v`` and the memory: the error in deg/s.
    helpers : tuple of str
        Functions that it calls.
    """

    law: Callable[[Mapping[str, float], Number, CMemory], str]
    helpers: tuple[str, ...] = ()


#: Whole powers.
POWER = """\
static inline @real@ PREFIX_power@f@(@real@ x, int order)
{
    @real@ power = 1;
    while (order-- > 0) {
        power *= x;
    }
    return power;
}
"""

#: What a sine lacks of its argument, as a share.
SINE_LOSS = """\
/* sin(x)/x - 1 by its series: the difference of nearly equal numbers would lose digits */
static inline @real@ PREFIX_sine_loss@f@(@real@ x)
{
    @real@ loss = 0;
    int k;
    for (k = 14; k > 0; k--) {
        loss = -x * x / (@real@)(2 * k * (2 * k + 1)) * (1 + loss);
    }
    return loss;
}
"""

#: Legendre polynomials, by the recurrence of `smooth.legendre`.
LEGENDRE = """\
static inline @real@ PREFIX_legendre@f@(@real@ x, int order)
{
    @real@ before = 0, now = 1;
    int n;
    for (n = 1; n <= order; n++) {
        const @real@ ahead = ((@real@)(2 * n - 1) * x * now - (@real@)(n - 1) * before) / (@real@)n;
        before = now;
        now = ahead;
    }
    return now;
}
"""

#: How far a reading is above a usual one, which counts for it where it is none.
ABOVE = """\
static inline @real@ PREFIX_above@f@(@real@ x, @real@ usual)
{
    return x - x <= 0 ? x - usual : 0;
}
"""

#: A Gaussian.
BUMP = """\
static inline @real@ PREFIX_bump@f@(@real@ x, @real@ center, @real@ width)
{
    const @real@ z = (x - center) / width;
    return exp@f@(-z * z / 2);
}
"""
