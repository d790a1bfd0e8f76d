"""Networks, evaluated in NumPy and Numba; PyTorch only trains them."""

from estimators.neural.lstm import Gru, Lru, Lstm2, LstmFcl
from estimators.neural.mlp import Mlp
from estimators.neural.network import Network
from estimators.neural.transformer import Transformer

NETWORKS: dict[str, type[Network]] = {
    network.kind: network for network in (Mlp, Lstm2, LstmFcl, Gru, Lru, Transformer)
}

__all__ = ["NETWORKS", "Gru", "Lru", "Lstm2", "LstmFcl", "Mlp", "Network", "Transformer"]
