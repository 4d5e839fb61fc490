"""Ranks of the codistribution, and the paper's matrix."""

import numpy as np
import pytest

from homeward.lab.observability.lie import (
    MAX_LANDMARKS,
    codistribution,
    model_point,
    observe_model,
    printed_matrix,
    rank_table,
)
from homeward.lab.observability.ranks import rank


@pytest.mark.parametrize("q", range(1, 7))
def test_the_rank_is_that_of_the_distances_and_bearings(q):
    assert observe_model(q).rank == min(2 * q, q + 3)
    assert observe_model(q, compass=True).rank == min(2 * q + 1, q + 3)
    assert observe_model(q, distances=True).rank == min(3 * q, q + 3)


@pytest.mark.parametrize("q", range(1, 7))
@pytest.mark.parametrize(("compass", "distances"), [(False, False), (True, False), (False, True)])
def test_a_higher_order_adds_nothing(q, compass, distances):
    gradients = codistribution(q, compass, distances, 2)
    for seed in range(2):
        found = rank(np.array(gradients(*model_point(q, seed))))
        assert found.clear
        assert found.value == observe_model(q, compass, distances).rank


def test_the_rank_of_the_largest_model_is_clear():
    assert observe_model(MAX_LANDMARKS).rank == MAX_LANDMARKS + 3


def test_the_table_of_the_issue():
    table = [(bearings, n) for _, n, bearings, *_ in rank_table()]
    assert table == [(2, 4), (4, 5), (6, 6), (7, 7), (8, 8), (9, 9)]


def test_printed_signs():
    """The model against complex steps of the rates by hand is in lab.model_by_hand."""
    entries = {e.name: e for e in printed_matrix()}
    for e in entries.values():
        assert e.value == pytest.approx(e.exact, rel=1e-12)
    assert [name for name, e in entries.items() if e.right] == ["J_i", "Q_i, term 1"]


def test_units_and_scales_do_not_change_a_rank():
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(12, 5)) @ rng.normal(size=(5, 8))
    scaled = 10 ** rng.uniform(-4, 4, 12)[:, None] * matrix * 10 ** rng.uniform(-4, 4, 8)
    found = rank(scaled)
    assert found.value == 5
    assert found.clear
    relative = np.abs(scaled @ found.null) / (np.abs(scaled) @ np.abs(found.null))
    assert relative.max() < 1e-9


def test_a_rank_that_floats_cannot_decide_is_not_clear():
    matrix = np.diag([1.0, 1e-9, 1e-11])
    assert not rank(matrix, np.ones(3)).clear
    assert rank(np.zeros((2, 3)), np.ones(3)).value == 0
