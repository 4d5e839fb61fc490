"""Ranks of the codistribution, in floats and in 60 digits, and the paper's matrix."""

import numpy as np
import pytest

from homeward.lab.observability.lie import (
    codistribution,
    evaluate,
    model_point,
    observe_model,
    precise_rank,
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
def test_floats_agree_with_sixty_digits_to_a_higher_order(q, compass, distances):
    gradients = codistribution(q, compass, distances, 2)
    precise = {precise_rank(evaluate(gradients, model_point(q, seed))) for seed in range(2)}
    assert precise == {observe_model(q, compass, distances).rank}


def test_sixty_digits_are_the_function():
    gradients = codistribution(3, True, True, 2)
    point = model_point(3, 7)
    exact = np.array([[float(v) for v in row] for row in evaluate(gradients, point)])
    np.testing.assert_allclose(exact, np.array(gradients(*point)), rtol=1e-9, atol=1e-8)


def test_the_table_of_the_issue():
    table = [(row.bearings, row.n) for row in rank_table()]
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
