from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.features import feature_set
from estimators.neural import Lstm2, LstmFcl, Mlp
from estimators.neural.modules import LstmFclModule, LstmModule, MlpModule
from limo_driver.errors import ModelStoreError

if TYPE_CHECKING:
    from estimators.neural import Network
    from estimators.neural.modules import Module

torch = pytest.importorskip("torch")

ALL, OWN = feature_set("all-joints", 7).columns, feature_set("drive", 7).columns


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)


def inputs(columns: np.ndarray, samples: int) -> np.ndarray:
    return np.random.default_rng(1).standard_normal((samples, columns.max() + 1))


@pytest.mark.parametrize("columns", [ALL, OWN], ids=["all-joints", "own-joint"])
def test_mlp_computes_what_was_trained(columns: np.ndarray) -> None:
    module = MlpModule(columns, 100, 1).double()
    x = inputs(columns, 9000)  # more than one block
    y, _ = Mlp(columns, module.weights()).advance(np.zeros(0), x)
    np.testing.assert_allclose(y, module(torch.from_numpy(x)).detach().numpy(), atol=1e-6)


LSTMS = {
    "paper": (LstmFcl, lambda: LstmFclModule(ALL[:1], 35, 7)),
    "two layers": (LstmFcl, lambda: LstmFclModule(ALL[:1], 55, 7, layers=2)),
    "own-joint": (LstmFcl, lambda: LstmFclModule(OWN, 8, 1)),
    "lstm-2": (Lstm2, lambda: LstmModule(ALL[:1], (35, 7))),
    "lstm-2 own-joint": (Lstm2, lambda: LstmModule(OWN, (8, 1))),
}


@pytest.fixture(params=LSTMS)
def lstm(request: pytest.FixtureRequest) -> tuple[Network, Module]:
    kind, build = LSTMS[request.param]
    module = build().double()
    return kind(module.columns_of_parts(), module.weights()), module


def test_lstm_computes_what_was_trained(lstm: tuple[Network, Module]) -> None:
    network, module = lstm
    x = inputs(network.columns, 300)
    y, _ = network.advance(network.init(1), x)
    expected, _ = module(torch.from_numpy(x)[None])
    assert network.outputs == y.shape[1] == 7
    np.testing.assert_allclose(y, expected[0].detach().numpy(), atol=1e-6)


def test_scanning_an_lstm_by_the_sample_equals_scanning_the_whole(
    lstm: tuple[Network, Module],
) -> None:
    network, _ = lstm
    x = inputs(network.columns, 60)
    whole, _ = network.advance(network.init(2), x)
    memory = network.init(2)
    for t in range(60):
        y, memory = network.advance(memory, x[t : t + 1])
        np.testing.assert_allclose(y[0], whole[t], atol=1e-12)


def test_a_strided_lstm_is_one_lstm_for_each_phase() -> None:
    module = LstmFclModule(OWN, 6, 1).double()
    network = LstmFcl(OWN, module.weights())
    x = inputs(OWN, 100)
    y, _ = network.advance(network.init(3), x)
    for phase in range(3):
        alone, _ = network.advance(network.init(1), x[phase::3])
        np.testing.assert_allclose(y[phase::3], alone, atol=1e-12)


def test_memory_carried_in_training_is_that_of_the_scan(lstm: tuple[Network, Module]) -> None:
    network, module = lstm
    x = torch.from_numpy(inputs(network.columns, 60))[None]
    whole, _ = module(x)
    first, memory = module(x[:, :25])
    second, _ = module(x[:, 25:], memory)
    np.testing.assert_allclose(
        torch.cat([first, second], dim=1).detach().numpy(), whole.detach().numpy(), atol=1e-12
    )


def test_initial_weights_are_xavier_and_biases_zero() -> None:
    module = MlpModule(ALL, 100, 1)
    bound = np.sqrt(6 / (35 + 100))
    weight = module.weights()["hidden_weight"]
    assert 0.95 * bound < np.abs(weight).max() <= bound
    assert not module.weights()["hidden_bias"].any()


def test_weights_that_do_not_fit_are_named() -> None:
    weights = MlpModule(OWN, 10, 1).weights()
    with pytest.raises(ModelStoreError, match="no weight 'hidden_bias'"):
        Mlp(OWN, {k: v for k, v in weights.items() if k != "hidden_bias"})
    with pytest.raises(ModelStoreError, match=r"'hidden_weight' has shape .* expected \(7, 35, 10"):
        Mlp(ALL, weights)
    with pytest.raises(ModelStoreError, match="'output_bias' is not finite"):
        Mlp(OWN, {**weights, "output_bias": np.full((7, 1), np.nan)})
    cells = LstmModule(ALL[:1], (35, 7)).weights()
    with pytest.raises(ModelStoreError, match="lstm-2: no weight 'gate_bias_2'"):
        Lstm2(ALL[:1], {k: v for k, v in cells.items() if k != "gate_bias_2"})
    with pytest.raises(ModelStoreError, match=r"'input_weight_2' has shape .* \(1, 35, 28\)"):
        Lstm2(ALL[:1], {**cells, "input_weight_2": np.zeros((1, 34, 28))})
