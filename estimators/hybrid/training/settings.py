"""How the network of a hybrid is trained: one frozen value, checked when it is made."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import Final

from estimators.hybrid.features import Features, feature_set
from estimators.neural import NETWORKS
from limo_driver.errors import ConfigError

SCHEDULES: Final = ("cosine", "plateau")
SPLITS: Final = ("blocks", "sequences", "recordings")
KEEPS: Final = ("best", "last")
DEVICES: Final = ("auto", "cpu", "cuda")
# Hidden units for one joint, and the width of a transformer.
WIDTHS: Final = {"mlp7": 100, "lstm-2": 16, "lstm-fcl": 16, "transformer": 32}
_CHOICES: Final = {
    "model": tuple(NETWORKS),
    "schedule": SCHEDULES,
    "split": SPLITS,
    "keep": KEEPS,
    "device": DEVICES,
}
_ABOVE_ZERO: Final = (
    *("epochs", "sequence_length", "batch", "bandwidth", "learning_rate", "folds"),
    *("layers", "carried", "heads"),
)
_ZERO_OR_MORE: Final = ("seed", "hidden", "weight_decay", "rate")
_HIGHEST_SEED: Final = 2**64 - 1  # that PyTorch takes
_LSTM_LAYERS: Final = 2  # at most, as in the paper's comparison of topologies
_PAPER_HIDDEN: Final = {"mlp7": 100, "lstm-2": 35, "lstm-fcl": 35, "transformer": 32}
_PAPER_LAYERS: Final = {"transformer": 2}  # 1 for the others


@dataclass(frozen=True)
class TrainingSettings:
    """How to train; `paper_settings` gives the paper's protocol.

    `split` says how motion is held out: as "blocks" of seconds, as "recordings", of which some are
    held out whole, or as the paper's "sequences", a random choice among neighbouring sub-sequences
    of `sequence_length`, which are more alike than any motion of use is.

    Raises:
        ConfigError: A setting names nothing known or cannot be; the message says which.
    """

    model: str = "mlp7"  # mlp7, lstm-2, lstm-fcl or transformer
    features: str = "all-joints"  # all-joints, own-joint or drive
    epochs: int = 100
    seed: int = 0
    bandwidth: float = 10.0  # of the filters on motion and torque [Hz]
    rate: float = 200.0  # of the network's samples [Hz]; 0: the recording's own, as in the paper
    sequence_length: int = 100  # samples through which a recurrent network is differentiated
    batch: int = 50  # rows of an mlp7, sequences of the others
    schedule: str = "cosine"  # of the learning rate; the paper has plateau
    learning_rate: float = 1e-3
    weight_decay: float = 0.01
    held_out: float = 0.2  # part of the motion
    folds: int = 3  # stretches of motion that judge how the network carries over; 1: none do
    hidden: int = 0  # units of each part; 0: 100 for mlp7, as many as inputs for one shared LSTM,
    # 32 for a transformer's d_model
    layers: int = 1  # LSTM layers of an lstm-fcl (1 or 2); encoder and decoder layers, each
    heads: int = 2  # of a transformer's attention
    without: tuple[str, ...] = ()  # quantities left out of the features, by name
    standalone: bool = False  # the network alone: no tau_RBD among its inputs, none added to it
    split: str = "blocks"  # blocks, sequences (the paper's) or recordings
    carried: int = 10  # sequences that a recurrent memory is carried through; 1: the paper's
    keep: str = "best"  # weights that are best on held-out motion, or last (the paper's)
    device: str = "auto"  # cpu, cuda, or auto: a GPU where PyTorch sees one

    def __post_init__(self) -> None:
        for name, known in _CHOICES.items():
            if getattr(self, name) not in known:
                kind = "network" if name == "model" else name
                raise ConfigError(
                    f"no {kind} is called {getattr(self, name)!r}; known: {', '.join(known)}"
                )
        for name in _ABOVE_ZERO:
            if not 0 < getattr(self, name) < inf:
                raise ConfigError(f"{name} = {getattr(self, name)} has to be above 0 and finite")
        for name in _ZERO_OR_MORE:
            if not 0 <= getattr(self, name) < inf:
                raise ConfigError(f"{name} = {getattr(self, name)} has to be 0 or more, and finite")
        if not 0 < self.held_out < 1:
            raise ConfigError(f"held_out = {self.held_out} has to lie between 0 and 1")
        if self.seed > _HIGHEST_SEED:
            raise ConfigError(f"seed = {self.seed} has to be {_HIGHEST_SEED} or less")
        if 0 < self.rate < self.bandwidth:
            raise ConfigError(
                f"rate = {self.rate:g} Hz has to be {self.bandwidth:g} Hz, the bandwidth, or more: "
                "slower samples miss whole swings of the motion"
            )
        self._check_layers()
        self.features_for(1)

    def features_for(self, n: int) -> Features:
        """Return the inputs of the network of an arm with n joints.

        Raises:
            ConfigError: The feature set is unknown, or lacks a quantity that is to be left out.
        """
        features = feature_set(self.features, n)
        known = {*features.quantities, *features.without}
        for name in self.without:
            if name not in known:
                raise ConfigError(
                    f"without: {self.features} has no {name!r}; known: {', '.join(sorted(known))}"
                )
        if self.standalone:
            features = replace(
                features, without=(*features.without, "rigid_body_torque"), compliance=0.0
            )
        features = replace(features, without=tuple(dict.fromkeys(features.without + self.without)))
        if not features.inputs:
            raise ConfigError(f"without: nothing is left of the features {self.features}")
        return features

    def _check_layers(self) -> None:
        most = {"mlp7": 1, "lstm-2": 1, "lstm-fcl": _LSTM_LAYERS}.get(self.model)
        if most is not None and self.layers > most:
            raise ConfigError(
                f"layers = {self.layers}, but {self.model} is built with at most {most}"
            )
        width = self.hidden or WIDTHS[self.model]
        if self.model == "transformer" and width % self.heads:
            raise ConfigError(f"hidden = {width} has to be a multiple of heads = {self.heads}")


def usual_settings(features: str) -> TrainingSettings:
    """Return the settings that suit a feature set: the defaults but for what follows.

    The few inputs of `drive` are learned within fewer passes and samples; more of either only teach
    the recordings by heart.
    """
    settings = TrainingSettings(features=features)
    if features == "drive":
        return replace(settings, epochs=20, rate=50.0, learning_rate=3e-3)
    return settings


def paper_settings(
    model: str,
    sequence_length: int = 500,
    *,
    without: tuple[str, ...] = (),
    standalone: bool = False,
    seed: int = 0,
) -> TrainingSettings:
    """Return the protocol of the paper, for each of its networks.

    100 epochs of AdamW at 1e-3, which shrinks when the training loss stops falling, in batches of
    50; every sample at the rate of the recording; sub-sequences from zero memory, a random fifth of
    them held out; the weights after the last epoch; the network's torque taken as it is. Weights
    start from Xavier's distribution, biases from zero. What differs: all samples of a sub-sequence
    are answered, where the paper answers the last, and inputs are clipped to what training saw.

    Args:
        model: mlp7, lstm-2, lstm-fcl or transformer.
        sequence_length: Samples T of a sub-sequence; the paper has 100 and 500.
        without: Quantities left out of the inputs, such as rotation_since_reversal.
        standalone: Without rigid-body torque, in the input and in the output.
        seed: Of the split, the order and the initial weights.

    Raises:
        ConfigError: There is no such network or quantity.

    Source: Çallar and Böttger, RA-L 2022, sec. III-B and III-D.
    """
    return TrainingSettings(
        model=model,
        epochs=100,
        seed=seed,
        rate=0.0,
        sequence_length=sequence_length,
        batch=50,
        schedule="plateau",
        learning_rate=1e-3,
        held_out=0.2,
        folds=1,
        hidden=_PAPER_HIDDEN.get(model, 0),
        layers=_PAPER_LAYERS.get(model, 1),
        without=without,
        standalone=standalone,
        split="sequences",
        carried=1,
        keep="last",
    )
