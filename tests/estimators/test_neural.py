from __future__ import annotations

import numpy as np
import pytest

from estimators.features import feature_set
from estimators.neural import LstmFcl, Mlp
from estimators.neural.modules import LstmModule, MlpModule
from limo_driver.errors import ModelStoreError

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


@pytest.mark.parametrize(
    ("columns", "hidden", "outputs"), [(ALL[:1], 35, 7), (OWN, 8, 1)], ids=["paper", "own-joint"]
)
def test_lstm_computes_what_was_trained(columns: np.ndarray, hidden: int, outputs: int) -> None:
    module = LstmModule(columns, hidden, outputs).double()
    x = inputs(columns, 300)
    network = LstmFcl(columns, module.weights())
    y, _ = network.advance(network.init(1), x)
    expected, _ = module(torch.from_numpy(x)[None])
    np.testing.assert_allclose(y, expected[0].detach().numpy(), atol=1e-6)


def test_a_strided_lstm_is_one_lstm_for_each_phase() -> None:
    module = LstmModule(OWN, 6, 1).double()
    network = LstmFcl(OWN, module.weights())
    x = inputs(OWN, 100)
    y, _ = network.advance(network.init(3), x)
    for phase in range(3):
        alone, _ = network.advance(network.init(1), x[phase::3])
        np.testing.assert_allclose(y[phase::3], alone, atol=1e-12)


def test_memory_carried_in_training_is_that_of_the_scan() -> None:
    module = LstmModule(ALL[:1], 35, 7).double()
    x = torch.from_numpy(inputs(ALL, 60))[None]
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
