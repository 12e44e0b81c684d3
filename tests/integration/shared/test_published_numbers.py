"""Numbers that SIDPAC's examples print, found again from the same records.

E. A. Morelli, System Identification Programs for Aircraft (SIDPAC), AIAA 2002-4704.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ident.structure.products import products_of
from ident.structure.selection import orthogonal, stepwise
from sim.aerodynamics import Term, parse_term
from tests.integration.command_line import CommandLine

AIRCRAFT = Path(__file__).parents[4] / "shared" / "flightdata" / "aircraft"
pytestmark = pytest.mark.skipif(
    not AIRCRAFT.is_dir(), reason="the folder of measured flights is not here"
)
FOOT = 0.3048  # m


def content_of(name: str) -> dict[str, Any]:
    from scipy.io import loadmat

    content: dict[str, Any] = loadmat(AIRCRAFT / name)
    return content


@pytest.mark.parametrize("method", [stepwise, orthogonal])
def test_stepwise_regression_chooses_the_printed_terms_with_the_printed_values(method: Any) -> None:
    content = content_of("swr_example.mat")
    names = ("x1", "x2", "x3", "x4")
    terms = [*(parse_term(name, names) for name in names), Term()]
    columns = np.column_stack([content["x"], np.ones(len(content["x"]))])
    measured, printed = content["z"].ravel(), content["p"].ravel()
    chosen, _ = method(products_of([columns], [measured], terms))
    assert sorted(chosen) == np.flatnonzero(printed).tolist()
    found = np.linalg.lstsq(columns[:, chosen], measured, rcond=None)[0]
    assert np.allclose(found, printed[chosen], rtol=1e-9)
    errors = dict(zip(content["pindx"].ravel() - 1, content["serr"].ravel(), strict=True))
    truth = content["p_true"].ravel()
    assert all(abs(truth[i] - printed[i]) < 2.0 * errors[i] for i in chosen)


@pytest.mark.long
def test_the_check_finds_the_printed_bias_of_the_pitch_rate(
    flightid: CommandLine, tmp_path: Path
) -> None:
    """F/A-18 HARV: 0.00178 rad/s; the scale of theta (1.0387) is told as one of q or of theta."""
    content = content_of("compat_lon_example.mat")
    rates, readings, other = content["u"], content["z"], content["fdata_250h"]
    columns = {
        "time [s]": content["t"].ravel(),
        "airspeed [m/s]": readings[:, 0] * FOOT,
        "alpha [rad]": readings[:, 1],
        "theta [rad]": readings[:, 2],
        **{f"{name} [m/s2]": rates[:, i] * FOOT for i, name in enumerate(("ax", "ay", "az"))},
        **{f"{name} [rad/s]": rates[:, 3 + i] for i, name in enumerate("pqr")},
        **{f"{name} [deg]": other[:, i] for name, i in (("beta", 2), ("phi", 7), ("psi", 9))},
    }
    record = tmp_path / "harv.csv"
    table = np.column_stack([*columns.values()])
    np.savetxt(record, table, "%.10g", ",", header=",".join(columns), comments="")
    content = json.loads(flightid.done("check", record, "--json"))
    found = {each["name"]: each for each in content["findings"]}
    # SIDPAC adds its bias to the measurement.
    printed, bias = float(content_of("compat_lon_example.mat")["pc"][2, 0]), found["bias:q"]
    assert abs(bias["value"] + printed) < 3.0 * bias["std"] < 0.2 * printed
    assert "sensor-scale:theta" in found["sensor-scale:q"]["group"]
