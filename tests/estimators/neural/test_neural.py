from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.hybrid.features import feature_set
from estimators.neural import Gru, Lru, Lstm2, LstmFcl, Mlp, Transformer
from estimators.neural.modules import (
    GruModule,
    LruModule,
    LstmFclModule,
    LstmModule,
    MlpModule,
    TransformerModule,
)
from estimators.neural.transformer import position_encoding
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
    "gru": (Gru, lambda: GruModule(ALL[:1], 35, 7, layers=2)),
    "gru own-joint": (Gru, lambda: GruModule(OWN, 8, 1)),
    "lru": (Lru, lambda: LruModule(ALL[:1], 12, 35, 7)),
    "lru own-joint": (Lru, lambda: LruModule(OWN, 8, 6, 1)),
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


def test_a_gru_is_that_of_torch() -> None:
    theirs = torch.nn.GRU(5, 4, batch_first=True).double()
    torch.nn.init.zeros_(theirs.bias_hh_l0)
    weights = {"output_weight": np.eye(4)[None], "output_bias": np.zeros((1, 4))}
    weights["gate_bias"] = theirs.bias_ih_l0.detach().numpy()[None]
    for name, of in (("input", theirs.weight_ih_l0), ("recurrent", theirs.weight_hh_l0)):
        weights[f"{name}_weight"] = of.detach().numpy().T[None]
    network, x = Gru(np.arange(5)[None], weights), inputs(np.arange(5), 40)
    y, _ = network.advance(network.init(1), x)
    expected = theirs(torch.from_numpy(x)[None])[0][0].detach().numpy()
    np.testing.assert_allclose(y, expected, atol=1e-12)


def test_states_of_an_lru_start_with_paces_from_samples_to_seconds_and_fade() -> None:
    network = Lru(OWN, LruModule(OWN, 16, 8, 1).double().weights())
    real, imaginary = network.weights["transition"].transpose(1, 0, 2)
    kept = np.hypot(real, imaginary)
    assert (kept < 1.0).all()
    assert kept.min() < np.exp(-1 / 20) < np.exp(-1 / 50) < kept.max()


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


BLOCK = 40
TRANSFORMERS = {
    "all-joints": lambda: TransformerModule(ALL[:1], 7, BLOCK, 16, 2, 4),
    "own-joint": lambda: TransformerModule(OWN, 1, BLOCK, 8, 1, 2),
}


@pytest.fixture(params=TRANSFORMERS)
def transformer(request: pytest.FixtureRequest) -> tuple[Transformer, TransformerModule]:
    module = TRANSFORMERS[request.param]().double()
    for name, value in module.named_parameters():  # biases and norms too, that start at 0 and 1
        torch.nn.init.normal_(value, std=0.3) if "qkv" not in name else None
    return Transformer(module.columns_of_parts(), module.weights()), module


def test_transformer_computes_what_was_trained_from_its_own_outputs(
    transformer: tuple[Transformer, TransformerModule],
) -> None:
    network, module = transformer
    x = inputs(network.columns, 100)
    y, _ = network.advance(network.init(1), x)
    for start in range(0, 100, BLOCK):
        rows = slice(start, start + BLOCK)
        before = np.concatenate([np.zeros((1, 7)), y[rows][:-1]])
        expected = module(torch.from_numpy(x[rows])[None], torch.from_numpy(before)[None])
        np.testing.assert_allclose(y[rows], expected[0].detach().numpy(), atol=1e-6)


def test_scanning_a_transformer_by_the_sample_equals_scanning_the_whole(
    transformer: tuple[Transformer, TransformerModule],
) -> None:
    network, _ = transformer
    x = inputs(network.columns, 100)
    whole, _ = network.advance(network.init(3), x)
    memory = network.init(3)
    for t in range(100):
        before = memory.copy()
        y, after = network.advance(memory, x[t : t + 1])
        np.testing.assert_allclose(y[0], whole[t], atol=1e-12)
        np.testing.assert_array_equal(memory, before)
        memory = after
    alone, _ = network.advance(network.init(1), x[1::3])
    np.testing.assert_allclose(whole[1::3], alone, atol=1e-12)


def test_a_transformer_looks_back_only_and_forgets_the_block_before(
    transformer: tuple[Transformer, TransformerModule],
) -> None:
    network, _ = transformer
    x = inputs(network.columns, 2 * BLOCK)
    changed = x.copy()
    changed[BLOCK - 1] += 1.0
    y, other = (network.advance(network.init(1), given)[0] for given in (x, changed))
    np.testing.assert_array_equal(y[: BLOCK - 1], other[: BLOCK - 1])
    assert np.abs(y[BLOCK - 1] - other[BLOCK - 1]).max() > 1e-3
    np.testing.assert_array_equal(y[BLOCK:], other[BLOCK:])


def test_positions_are_encoded_by_sinusoids() -> None:
    encoding = position_encoding(50, 6)
    np.testing.assert_allclose(encoding[:, 0], np.sin(np.arange(50)))
    np.testing.assert_allclose(encoding[:, 5], np.cos(np.arange(50) / 10_000 ** (4 / 6)))


def test_transformer_weights_that_do_not_fit_are_named() -> None:
    weights = TransformerModule(ALL[:1], 7, BLOCK, 16, 2, 4).weights()
    with pytest.raises(ModelStoreError, match="transformer: no weight 'cross_join'"):
        Transformer(ALL[:1], {k: v for k, v in weights.items() if k != "cross_join"})
    with pytest.raises(ModelStoreError, match=r"'decoder_qkv' .* expected \(1, 2, 3, 16, 4, 4\)"):
        Transformer(ALL[:1], {**weights, "decoder_qkv": weights["decoder_qkv"][:, :1]})


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
