"""Motion to a tolerance by LSODA, which chooses step and order itself, from one jump of the inputs to the next.

Source: L. Petzold, Automatic selection of methods for solving stiff and nonstiff systems of ordinary differential equations, SIAM J. Sci.
Stat. Comput. 4 (1983) 136-148, as SciPy's `odeint` carries it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import numpy as np

from sim.declaration.system import System

InputsAt = Callable[[float], list[float]]
Stretch = Callable[[float, float], InputsAt]

RELATIVE, ABSOLUTE = 1e-10, 1e-12  # of a step's error in each state, SI: a flight's is then below 1e-9 of its motion
_MOST_STEPS = 5000  # between two samples: one that needs more is not of this kind


def smooth_motion(
    system: System, p: Sequence[float], x0: Sequence[float], stretch: Stretch, breaks: Sequence[float], time: np.ndarray
) -> np.ndarray | None:
    """States ``(n, N)`` at ``time``; None where the solver cannot keep its tolerance or the rates are not defined.

    ``stretch(begin, end)`` gives the inputs between two ``breaks`` (s), the times at which one may jump or bend. No step is longer than
    the usual sample interval, so that what acts for longer than that is not stepped over.
    """
    from scipy.integrate import ODEintWarning, odeint  # imported late: it takes longer than a flight

    ends = [*(at for at in breaks if time[0] + 1e-9 < at < time[-1] - 1e-9), float(time[-1])]
    usual = float(np.median(np.diff(time)))
    found = np.empty((len(x0), len(time)))
    found[:, 0] = x = np.asarray(x0, dtype=float)
    begin, done, fixed = float(time[0]), 1, list(p)
    for end in ends:
        u, last = stretch(begin, end), int(np.searchsorted(time, end + 1e-9))
        at = np.concatenate([[begin], time[done:last], [end]] if time[last - 1] < end else [[begin], time[done:last]])

        def rates(t: float, x: np.ndarray, u: InputsAt = u) -> list[float]:
            return system.f(t, x.tolist(), u(t), fixed)

        try:
            with warnings.catch_warnings(), np.errstate(over="raise", invalid="raise", divide="raise"):
                warnings.simplefilter("error", ODEintWarning)
                way = odeint(rates, x, at, tfirst=True, rtol=RELATIVE, atol=ABSOLUTE, tcrit=[end], hmax=usual, mxstep=_MOST_STEPS)
        except (ArithmeticError, ODEintWarning, ValueError):
            return None
        if not np.all(np.isfinite(way)):
            return None
        found[:, done:last] = way[1 : 1 + last - done].T
        begin, done, x = end, last, way[-1]
    return found
