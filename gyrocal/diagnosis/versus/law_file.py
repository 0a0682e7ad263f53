"""A law as a Python file that needs numpy alone: the very functions of the catalogue, with the numbers found.

The sources are copied from `gyrocal.physics`, each function with what it calls, so that the file says exactly what
was fitted; lag, heat and play, which the catalogue runs compiled, stand there as plain loops.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from types import ModuleType
from typing import Any

import numpy as np

from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.c_text import CMemory
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.kernels import PAUSE_S, PAUSE_STEPS
from gyrocal.physics.smooth import SmoothTerm
from gyrocal.physics.surface import Surface
from gyrocal.physics.thermal import temperature_rate_c_per_s

#: What the file defines by itself.
_OWN = {"lag", "heat", "play", "Conditions", "Surface", "need_surface"}

_HEAD = '''\
"""@title@

Add to the simulated output, sample by sample in time order, with t_s on the recording's clock:

    output_dps = simulated_dps + added_dps(rate_dps, temp_c, t_s=t_s@by_rate@)

Channels that a law needs and that were not given are named in the error. Arrays of shape (n,), NaN nowhere.

@formula@
"""

from __future__ import annotations

import numpy as np
@imports@

class Conditions:
    """Channels of the samples."""

    sample_std_dps = 0.0

    def __init__(self, rate_dps, temp_c, **channels):
        self.rate_dps, self.temp_c = rate_dps, temp_c
        self.channels = channels

    def __len__(self):
        return len(self.rate_dps)

    def __getattr__(self, name):
        return self.channels.get(name)

    # Laws of the catalogue that read these as they are do it where they were measured.
    t_s = property(lambda self: self.need("t_s"))
    supply_v = property(lambda self: self.need("supply_v"))

    def need(self, name):
        """A channel that a law cannot do without."""
        if self.channels.get(name) is None:
            raise ValueError(f"the law needs {name}: give it by this name")
        return self.channels[name]

    def since(self, at_s):
        """Which samples come after an instant."""
        return (self.need("t_s") >= at_s).astype(float)

    def turned(self, harmonic, phase_rad):
        """Cosine of so many periods a turn of the table, plus a phase."""
        return np.cos(harmonic * np.radians(self.need("angle_deg")) + phase_rad)


class Surface:
    """Error polynomial ``sum c[i][j] u^i v^j`` in deg/s, of the gyro's output or of its input."""

    def __init__(self, c, center_dps, scale_dps, center_c, scale_c, direction):
        self.c, self.direction = c, direction
        self.center_dps, self.scale_dps, self.center_c, self.scale_c = center_dps, scale_dps, center_c, scale_c

    def error_dps(self, x_dps, temp_c):
        u, v = (x_dps - self.center_dps) / self.scale_dps, (temp_c - self.center_c) / self.scale_c
        a = [c[0] + v * (c[1] + v * c[2]) for c in self.c]
        return a[0] + u * (a[1] + u * (a[2] + u * a[3]))

    def added_dps(self, rate_dps, temp_c):
        """Output less true rate; of a surface in the output by repetition, its slope being small."""
        error = self.error_dps(rate_dps, temp_c)
        if self.direction == "output":
            for _ in range(60):
                error = self.error_dps(rate_dps + error, temp_c)
        return error


def need_surface(surface, effect):
    return surface


def lag(t_s, values, tau_s, memory=None):
    """How far a first-order low-pass of `values` is behind them; exact where they are linear between samples."""
    out = np.zeros(len(values))
    for k in range(1, len(values)):
        step = max(t_s[k] - t_s[k - 1], 0.0) / tau_s
        gain = -np.expm1(-step) / step if step > 0 else 1.0
        out[k] = np.exp(-step) * out[k - 1] + gain * (values[k] - values[k - 1])
    return out, None


def heat(t_s, rate_dps, tau_s, memory=None):
    """Low-passed squares of past rates, of which there were none before the first; in a long pause it stands."""
    squares = np.asarray(rate_dps, dtype=float) ** 2
    behind = np.array(squares)
    usual = 0.0
    for k in range(1, len(squares)):
        since, last, now = max(t_s[k] - t_s[k - 1], 0.0), squares[k - 1], squares[k]
        if usual > 0.0 and since > max(@pause_s@, @pause_steps@ * usual):
            end = np.exp(-0.5 * usual / tau_s)
            rest = np.exp(-(since - usual) / tau_s)
            behind[k] = end * (rest * (end * behind[k - 1] - last) + now)
        else:
            step = since / tau_s
            gain = -np.expm1(-step) / step if step > 0 else 1.0
            behind[k] = np.exp(-step) * behind[k - 1] + gain * (now - last)
        usual = since
    return squares - behind, None


def play(values, half_width, position=None):
    """Position of a play (backlash) of the given half width, which begins in its middle."""
    out = np.array(values, dtype=float)
    for k in range(1, len(out)):
        out[k] = max(values[k] - half_width, min(values[k] + half_width, out[k - 1]))
    return out, None

'''

_SMOOTH_HELP = """
def above(x, usual):
    return np.where(np.isfinite(x), x - usual, 0.0)


def bump(x, center, width):
    return np.exp(-0.5 * ((x - center) / width) ** 2)


def legendre(x, order):
    before, now = np.zeros(np.shape(x)), np.ones(np.shape(x))
    for n in range(1, order + 1):
        before, now = now, ((2 * n - 1) * x * now - (n - 1) * before) / n
    return now

"""

_TAIL = '''
#: What samples may have beside rate and temperature.
CHANNELS = @channels@


def added_dps(rate_dps, temp_c, **channels):
    """What the simulation lacks at true rates (deg/s) and temperatures (deg C), deg/s, shape (n,).

    Channels by name: those of `CHANNELS`.
    """
    unknown = sorted(channels.keys() - set(CHANNELS))
    if unknown:
        raise TypeError(f"{unknown[0]} is no channel of the law; CHANNELS lists them")
    w, temp = (np.atleast_1d(np.asarray(x, dtype=float)) for x in (rate_dps, temp_c))
    given = {name: np.atleast_1d(np.asarray(x, dtype=float)) for name, x in channels.items()}
    if BEGAN_S is not None and "t_s" in given:
        given.setdefault("since_power_on_s", given["t_s"] - BEGAN_S)
@checks@    c = Conditions(w, temp, **given)
    e = SURFACE.added_dps(w, temp) - SIMULATED.added_dps(w, temp)
@terms@
    return e
'''


#: Where the law counts from power-on.
_SINCE_ON = """\
    if np.any(given.get("since_power_on_s", 0.0) < 0.0):
        raise ValueError("there are samples before power-on: give t_s on the recording's clock, or since_power_on_s")
"""
#: Where it goes with the rate of the temperature, which samples far apart do not tell.
_BY_RATE = """\
    far_s = np.median(np.diff(given["t_s"])) if len(given.get("t_s", ())) > 1 else 0.0
    if far_s > SMOOTHING_S and "temp_rate_c_per_s" not in given:
        raise ValueError(
            f"the law needs temp_rate_c_per_s, deg C/s, of samples {far_s:.3g} s apart: give it by this name"
        )
"""
_CHANNELS = tuple(
    f.name for f in fields(Conditions) if f.name not in ("rate_dps", "temp_c", "sample_std_dps")
)


def python_file(
    coefficients: Coefficients,
    already: Surface,
    title: str,
    formula: str,
    began_s: float | None = None,
    rms_dps: Sequence[float] = (),
) -> str:
    """Source of a module with one function, ``added_dps(rate_dps, temp_c, **channels)``.

    Parameters
    ----------
    coefficients : surface of the gyro, and terms of bench and robot alike
    already : the surface that the simulation has
    title, formula : for the module's docstring
    began_s : from which t_s on the time since power-on counts, where nobody said when that was
    rms_dps : what each term adds over the recording, deg/s; they stand in this order, the largest first
    """
    sizes = rms_dps or [float("nan")] * len(coefficients.terms)
    order = sorted(range(len(sizes)), key=lambda k: -sizes[k])
    laws: dict[str, str] = {}
    modules: dict[str, str] = {}
    parts, lines = [], []
    for number, k in enumerate(order, 1):
        term, said = coefficients.terms[k], _size_comment(sizes[k])
        if isinstance(term, SmoothTerm):
            parts.append(_smooth_source(term, number))
            lines.append(f"    e = e + part_{number}(c){said}")
            continue
        effect = find_effect(term.effect)
        law = inspect.getclosurevars(effect.error_dps).nonlocals.get("law", effect.error_dps)
        _collect(law, laws, modules)
        memory = "" if law is not effect.error_dps else ", None"
        first = "[0]" if memory else ""
        values = effect.typical() | {name: float(p["value"]) for name, p in term.parameters.items()}
        lines.append(f"    e = e + {law.__name__}(c, {values!r}, SURFACE{memory}){first}{said}")
    smooth = _SMOOTH_HELP if parts else ""
    imports = "".join(f"{line}\n" for line in modules.values())
    head = _HEAD.replace("@pause_s@", repr(PAUSE_S)).replace("@pause_steps@", repr(PAUSE_STEPS))
    head = head.replace("@title@", title).replace("@formula@", formula).replace("@imports@", imports)
    surfaces = (
        _surface_source("SURFACE", coefficients.surface),
        _surface_source("SIMULATED", already),
    )
    body = "\n\n".join([*laws.values(), *parts, *surfaces])
    began = f"#: t_s from which since_power_on_s counts where it is not given.\nBEGAN_S = {began_s!r}\n"
    by_rate = temperature_rate_c_per_s.__name__ in laws
    head = head.replace("@by_rate@", ", temp_rate_c_per_s=temp_rate_c_per_s" if by_rate else "")
    checks = (_SINCE_ON if "since_power_on_s" in body else "") + (_BY_RATE if by_rate else "")
    tail = _TAIL.replace("@terms@", "\n".join(lines)).replace("@checks@", checks)
    tail = tail.replace("@channels@", repr(_CHANNELS))
    return head + smooth + "\n" + began + "\n" + body + "\n\n" + tail


def _size_comment(rms_dps: float) -> str:
    return f"  # {1e3 * rms_dps:.2g} mdeg/s rms" if np.isfinite(rms_dps) else ""


def _surface_source(name: str, s: Surface) -> str:
    rows = ",\n".join(f"        {row!r}" for row in s.coefficients_dps.tolist())
    rest = f"{s.rate_center_dps!r}, {s.rate_scale_dps!r}, {s.temp_center_c!r}, {s.temp_scale_c!r}, {s.direction!r}"
    return f"{name} = Surface(\n    [\n{rows},\n    ],\n    {rest},\n)\n"


def _smooth_source(term: SmoothTerm, number: int) -> str:
    """The sum of its columns; their C, which has no operator that Python has not, read as Python."""
    memory = CMemory()
    laws, _ = term.c_laws(repr, memory)
    lines = [
        f"def part_{number}(c):",
        f'    """{term.family}: {term.label}."""',
        "    w, temp_c = c.rate_dps, c.temp_c",
    ]
    if memory.tau_s:
        lines.append(f"    behind_c = [lag(c.need('t_s'), temp_c, tau_s)[0] for tau_s in {memory.tau_s!r}]")
    if memory.heat_tau_s:
        lines.append(f"    heat_dps2 = [heat(c.need('t_s'), w, tau_s)[0] for tau_s in {memory.heat_tau_s!r}]")
    if memory.width_c:
        lines.append(f"    play_c = [play(temp_c, half_width)[0] for half_width in {memory.width_c!r}]")
    if any("since_power_on_s" in law for law in laws):
        lines.append("    since_power_on_s = c.need('since_power_on_s')")
    if any("supply_v" in law for law in laws):
        lines.append("    supply_v = c.need('supply_v')")
    lines.append("    e = np.zeros(len(c))")
    functions = {"exp": "np.exp", "fabs": "np.abs", "asinh": "np.arcsinh", "tanh": "np.tanh"}
    for law in laws:
        text = law.replace("(@real@)", "").replace("PREFIX_", "").replace("s->", "")
        text = re.sub(rf"\b({'|'.join(functions)})@f@", lambda found: functions[found[1]], text).replace(
            "@f@", ""
        )
        lines.append(f"    e = e + {text}")
    return "\n".join([*lines, "    return e\n"])


def _collect(function: Callable[..., Any], found: dict[str, str], modules: dict[str, str]) -> None:
    """The source of a function, after that of what it calls and the constants that it reads."""
    if function.__name__ in found:
        return
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    definition = tree.body[0]
    names = {node.id for node in ast.walk(_without_annotations(definition)) if isinstance(node, ast.Name)}
    known: Mapping[str, Any] = inspect.unwrap(function).__globals__
    for name in sorted(names & known.keys() - _OWN):
        value = known[name]
        if isinstance(value, ModuleType):
            if name != "np":
                modules[name] = f"import {value.__name__}"
        elif inspect.isfunction(value):
            _collect(value, found, modules)
        elif isinstance(value, (bool, int, float, str, tuple)):
            found[name] = f"{name} = {value!r}\n"
    found[function.__name__] = ast.unparse(definition) + "\n"


def _without_annotations(tree: ast.AST) -> ast.AST:
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.FunctionDef):
            node.returns = None
    return tree
