"""Training settings of a hybrid's network: one frozen value, checked when it is made."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from estimators.hybrid.features import Features, feature_set
from estimators.neural import NETWORKS
from limo_driver.errors import ConfigError
from limo_driver.recordings.bandwidth import BANDWIDTH
from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.runtime.plugins import require_package

SCHEDULES: Final = ("cosine", "plateau")
SPLITS: Final = ("blocks", "sequences", "recordings")
KEEPS: Final = ("best", "last")
DEVICES: Final = ("auto", "cpu", "cuda")
# Hidden units for one joint, and the width of a transformer.
WIDTHS: Final = {
    "mlp7": 100, "lstm-2": 16, "lstm-fcl": 16, "gru": 16, "lru": 16, "transformer": 32
}  # fmt: skip
_LAYERS: Final = {"mlp7": 1, "lstm-2": 1, "lstm-fcl": 2, "gru": 2, "lru": 1}  # at most
_PAPER_HIDDEN: Final = WIDTHS | dict.fromkeys(("lstm-2", "lstm-fcl", "gru", "lru"), 35)
_PAPER_LAYERS: Final = {"transformer": 2}  # 1 for the others


def _above_zero(unit: str, default: float):  # noqa: ANN202  # a dataclass field
    return parameter(unit, lower=0, above=True, default=default)


@dataclass(frozen=True)
class TrainingSettings(Declared):
    """Settings of training; `paper_settings` gives the paper's protocol.

    `split` says how motion is held out: as "blocks" of seconds, as "recordings", of which some are
    held out whole, or as the paper's "sequences", a random choice among neighbouring sub-sequences
    of `sequence_length`, which are more alike than any motion of use is.

    Args:
        model: Of network: mlp7, lstm-2, lstm-fcl, gru, lru, transformer.
        features: Inputs: all-joints, own-joint or drive.
        epochs: Passes over the motion, at least 1.
        seed: Of every random draw.
        bandwidth: Of the filters on motion and torque [Hz].
        rate: Of the network's samples [Hz]; 0: the recording's, as in the paper.
        sequence_length: Samples through which a recurrent network is differentiated.
        batch: Rows of an mlp7, sequences of the others.
        schedule: Of the learning rate: cosine, or the paper's plateau.
        learning_rate: Of AdamW at the start.
        weight_decay: Of AdamW.
        held_out: Part of the motion, between 0 and 1.
        folds: Stretches of motion that judge how the network carries over; 1: none do.
        hidden: Units of each part; 0: 100 for mlp7, as many as inputs for one shared LSTM, GRU
            or LRU, 32 for a transformer's d_model.
        layers: Cells of an lstm-fcl or gru, one above the other (1 or 2); encoder and decoder
            layers, each.
        heads: Of a transformer's attention.
        without: Quantities left out of the features, by name.
        standalone: The network alone: no rigid body among its inputs, none added to it.
        split: How motion is held out: blocks, sequences, recordings.
        carried: Sequences that a recurrent memory is carried through; 1: the paper's.
        keep: Weights that are the best on held-out motion, or the last ones (the paper's).
        patience: Epochs without a lower held-out loss after which training ends; 0: never, as in
            the paper.
        device: cpu, cuda, or auto: a GPU where PyTorch sees one; an mlp7 is trained on the CPU,
            which is sooner.

    Raises:
        ConfigError: A setting names nothing known or cannot be; the message says which.

    Example:
        >>> short = limo.TrainingSettings(epochs=20, held_out=0.3)
        >>> limo.train("sim.yaml", "run.parquet", "mlp7", settings=short)
    """

    model: str = parameter("", of=NETWORKS, default="mlp7")
    features: str = "all-joints"  # all-joints, own-joint or drive
    epochs: int = _above_zero("", 100)
    seed: int = parameter("", lower=0, upper=2**64 - 1, default=0)  # as PyTorch takes it
    bandwidth: float = _above_zero("Hz", BANDWIDTH)
    rate: float = parameter("Hz", lower=0, default=200.0)
    sequence_length: int = _above_zero("", 100)
    batch: int = _above_zero("", 50)
    schedule: str = parameter("", of=SCHEDULES, default="cosine")
    learning_rate: float = _above_zero("", 1e-3)
    weight_decay: float = parameter("", lower=0, default=0.01)
    held_out: float = parameter("", default=0.2)
    folds: int = _above_zero("", 3)
    hidden: int = parameter("", lower=0, default=0)
    layers: int = _above_zero("", 1)
    heads: int = _above_zero("", 2)
    without: tuple[str, ...] = ()  # quantities left out of the features, by name
    standalone: bool = False  # the network alone: no tau_RBD among its inputs, none added to it
    split: str = parameter("", of=SPLITS, default="blocks")
    carried: int = _above_zero("", 10)
    keep: str = parameter("", of=KEEPS, default="best")
    patience: int = parameter("", lower=0, default=20)
    device: str = parameter("", of=DEVICES, default="auto")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.held_out < 1:
            raise self._refused("held_out", "a number between 0 and 1")
        if 0 < self.rate < self.bandwidth:
            raise ConfigError(
                f"rate = {self.rate:g} Hz has to be {self.bandwidth:g} Hz, the bandwidth, or more: "
                "slower samples miss whole swings of the motion"
            )
        if self.layers > (most := _LAYERS.get(self.model, self.layers)):
            raise ConfigError(
                f"layers = {self.layers}, but {self.model} is built with at most {most}"
            )
        width = self.hidden or WIDTHS[self.model]
        if self.model == "transformer" and width % self.heads:
            raise ConfigError(f"hidden = {width} has to be a multiple of heads = {self.heads}")
        self.features_for(1)

    def following(self, bandwidth: float) -> TrainingSettings:
        """Return the settings for a bandwidth [Hz], with samples that are fast enough for it."""
        rate = self.rate and max(self.rate, bandwidth)
        return replace(self, bandwidth=bandwidth, rate=rate)

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


def usual_settings(features: str, model: str = "mlp7") -> TrainingSettings:
    """Return the settings that suit a feature set: the defaults but for what follows.

    The few inputs of `drive` are learned within fewer passes and samples; more of either only teach
    a network without memory the recordings by heart. One with memory takes few steps in a pass.
    """
    settings = TrainingSettings(model=model, features=features)
    if features != "drive":
        return settings
    epochs = settings.epochs if NETWORKS[model].recurrent else 20
    return replace(settings, epochs=epochs, rate=50.0, learning_rate=3e-3)


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
        model: mlp7, lstm-2, lstm-fcl, gru, lru or transformer.
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
        patience=0,
    )


def require_torch() -> None:
    """Check, before anything long begins, that a network can be trained here.

    Raises:
        MissingPackageError: PyTorch is not installed; a light installation lacks it.
    """
    require_package("torch", "training a network")
