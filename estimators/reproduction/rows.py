"""The rows of Table I and of the paper's comparison of topologies, and the paper's figures."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.hybrid.training.settings import TrainingSettings, paper_settings

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

PERCEPTRON: Final = "mlp7"  # of `TrainingSettings`
PARTS: Final = ("training", "test", "validation")
PAPER_JOINTS: Final = 7
_COLUMNS: Final = (*(f"joint_{j}" for j in range(1, PAPER_JOINTS + 1)), "joint_average")
HISTORY: Final = "rotation_since_reversal"  # r of the paper


@dataclass(frozen=True)
class Row:
    """One architecture with one choice of inputs; named as in the paper's table."""

    name: str
    model: str | None  # of `TrainingSettings`; None: the rigid body alone
    sequence_length: int = 100  # T, of the network's memory and of the sub-sequences that are split
    rigid_body: bool = True  # tau_RBD among the inputs and added to the output
    history: bool = True  # r among the inputs
    layers: int = 0  # 0: the paper's
    hidden: int = 0  # 0: the paper's

    def settings(self) -> TrainingSettings:
        """Return the paper's protocol for this row; that of the rigid body only says how to split.

        Raises:
            ConfigError: The network cannot be trained.
        """
        settings = paper_settings(
            self.model or PERCEPTRON,
            self.sequence_length,
            without=() if self.history else (HISTORY,),
            standalone=not self.rigid_body,
        )
        return replace(
            settings, layers=self.layers or settings.layers, hidden=self.hidden or settings.hidden
        )


ALONE: Final = {"rigid_body": False, "history": False}

RBD: Final = Row("RBD", None)
MLP: Final = Row("MLP-7", PERCEPTRON, **ALONE)
MLP_HYBRID: Final = Row("MLP-7 with tau_rbd", PERCEPTRON, history=False)
MLP_FULL: Final = Row("MLP-7 with tau_rbd,r", PERCEPTRON)
LSTM2: Final = Row("LSTM-2 100", "lstm-2", **ALONE)
LSTM2_HYBRID: Final = Row("LSTM-2 100 with tau_rbd", "lstm-2", history=False)
LSTM2_FULL: Final = Row("LSTM-2 100 with tau_rbd,r", "lstm-2")
FCL100: Final = Row("LSTM-FCL 100", "lstm-fcl", **ALONE)
FCL100_HISTORY: Final = Row("LSTM-FCL 100 with r", "lstm-fcl", rigid_body=False)
FCL100_FULL: Final = Row("LSTM-FCL 100 with tau_rbd,r", "lstm-fcl")
FCL500: Final = Row("LSTM-FCL 500", "lstm-fcl", 500, **ALONE)
FCL500_HYBRID: Final = Row("LSTM-FCL 500 with tau_rbd", "lstm-fcl", 500, history=False)
FCL500_FULL: Final = Row("LSTM-FCL 500 with tau_rbd,r", "lstm-fcl", 500)
TRANSFORMER: Final = Row("Transformer 500 with tau_rbd,r", "transformer", 500)

ROWS: Final = (
    *(RBD, MLP, MLP_HYBRID, MLP_FULL, LSTM2, LSTM2_HYBRID, LSTM2_FULL),
    *(FCL100, FCL100_HISTORY, FCL100_FULL, FCL500, FCL500_HYBRID, FCL500_FULL, TRANSFORMER),
)

_BEST: Final = (1, 35)  # layers and width of the row of the table whose topology is varied

TOPOLOGIES: Final = {
    (layers, hidden): FCL500_FULL
    if (layers, hidden) == _BEST
    else replace(
        FCL500_FULL, name=f"{FCL500_FULL.name}, {layers} x {hidden}", layers=layers, hidden=hidden
    )
    for layers in (1, 2)
    for hidden in (15, 35, 55)
}


@cache
def paper_table() -> dict[tuple[str, str], FloatArray]:
    """Return the paper's figures: part and row → MSE of joints 1 to 7 and average, (8,) [(N m)²].

    All are as printed; a few of the averages are not the mean of the seven figures beside them.

    Source: Çallar and Böttger, RA-L 2022, Table I.
    """
    text = (files("estimators.reproduction") / "paper_table1.csv").read_text(encoding="utf-8")
    lines = (line for line in text.splitlines() if not line.startswith("#"))
    return {
        (row["split"], row["architecture"]): np.array([float(row[name]) for name in _COLUMNS])
        for row in csv.DictReader(lines)
    }
