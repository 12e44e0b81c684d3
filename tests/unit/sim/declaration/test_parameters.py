"""Parameters and ordered sets of them: what is refused, and what a change leaves as it was."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from sim.declaration.effect import Parameter, ParameterSet
from sim.errors import ModelError

THREE = ParameterSet(
    (
        Parameter("a", 1.0, "m"),
        Parameter("b", 2.0, free=False),
        Parameter("c", 3.0, bounds=(0.0, 5.0), prior_std=0.5),
    )
)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"value": math.nan}, "not a finite number"),
        ({"value": math.inf}, "not a finite number"),
        ({"value": 2.0, "bounds": (0.0, 1.0), "unit": "kg"}, r"2 kg lies outside \[0, 1\]"),
        ({"value": 1.0, "prior_std": 0.0}, "prior standard deviation 0 is not positive"),
        ({"value": 1.0, "prior_std": math.nan}, "not positive"),
    ],
)
def test_a_wrong_parameter_is_refused_by_name(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        Parameter("mass", **arguments)  # type: ignore[arg-type]
    assert "parameter mass" in str(caught.value) and "\n" not in str(caught.value)


def test_bounds_are_inclusive() -> None:
    assert Parameter("delay", 0.0, bounds=(0.0, 1.0)).value == 0.0


def test_a_set_keeps_order_and_finds_by_name() -> None:
    assert THREE.names == ("a", "b", "c") and THREE.free_names == ("a", "c")
    assert len(THREE) == 3 and "b" in THREE and "d" not in THREE
    assert [item.name for item in THREE] == ["a", "b", "c"]
    assert THREE.index("c") == 2 and THREE["c"].value == 3.0
    np.testing.assert_array_equal(THREE.values(), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(THREE.values(["c", "a"]), [3.0, 1.0])


def test_names_are_unique_and_unknown_ones_are_told() -> None:
    with pytest.raises(ModelError, match="parameter a: declared twice"):
        THREE.joined([Parameter("a", 0.0)])
    for act in (
        lambda: THREE["d"],
        lambda: THREE.with_values({"d": 1.0}),
        lambda: THREE.hold(["d"]),
        lambda: THREE.only_free(["d"]),
    ):
        with pytest.raises(ModelError, match=r"d: there is no such parameter; use one of a, b, c"):
            act()


def test_changes_return_a_new_set() -> None:
    changed = THREE.with_values({"c": 4.0}).with_prior({"a": 0.1}).hold(["a"]).release(["b"])
    assert changed.free_names == ("b", "c")
    assert changed["c"] == dataclasses.replace(THREE["c"], value=4.0)
    assert changed["a"].prior_std == 0.1 and THREE["a"].prior_std == math.inf and THREE["a"].free
    assert THREE.only_free(["b"]).free_names == ("b",)
    assert THREE.joined([Parameter("d", 0.0)]).names == ("a", "b", "c", "d")
    with pytest.raises(ModelError, match="outside"):
        THREE.with_values({"c": 6.0})
    with pytest.raises(dataclasses.FrozenInstanceError):
        THREE["a"].value = 2.0  # type: ignore[misc]
