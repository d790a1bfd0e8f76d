"""Train a challenger of a given kind of model."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, Final

from estimators.hybrid import HybridModel
from estimators.neural import NETWORKS
from estimators.registry import to_train, trained_by_name
from limo_driver.errors import ConfigError, ModelStoreError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from estimators.hybrid.training.settings import TrainingSettings
    from estimators.residual_model import ResidualModel
    from limo_driver.recordings.recording import Recording

SAME: Final = "same"  # as the champion


def check_kind(kind: str) -> None:
    """Check that a challenger can be of a kind.

    Raises:
        ConfigError: No estimator that learns beside a service is called so.
        PlugInError: It is of another distribution and cannot be used.
    """
    known = (SAME, *trained_by_name(), *NETWORKS)
    if kind not in known:
        raise ConfigError(f"no kind of challenger is {kind!r}; known: {', '.join(known)}")
    if kind not in (SAME, *NETWORKS):
        to_train(kind, (SAME, *NETWORKS))


def learned(kind: str, champion: ResidualModel[Any], recording: Recording) -> ResidualModel[Any]:
    """Return a model fitted to the residual of the champion's simulation on a recording.

    Args:
        kind: `same` as the champion, with the settings that it was trained with; an estimator that
            is trained by its name, as `joint-physics`; or a network, with its usual settings.
        champion: Whose simulation, bandwidth and settings.
        recording: To learn from.

    Raises:
        ConfigError: There is no such kind, or PyTorch is not there for a network.
        ModelStoreError: A champion does not say how it was trained.
        RecordingError: The recording says too little.
    """
    check_kind(kind)
    wanted = champion.name if kind == SAME else kind
    if wanted in trained_by_name():
        estimator = to_train(wanted)
        return estimator.unfitted(champion.simulation, champion.bandwidth).fit([recording])
    settings = _settings(wanted, champion)
    return HybridModel(champion.simulation, settings).fit([recording])


def _settings(wanted: str, champion: ResidualModel[Any]) -> TrainingSettings:
    from estimators.hybrid.training.settings import usual_settings

    if wanted in NETWORKS:
        settings = replace(usual_settings("drive"), model=wanted)
    else:
        settings = _settings_of(champion)
    return replace(settings, bandwidth=champion.bandwidth, device="cpu")


def _settings_of(champion: ResidualModel[Any]) -> TrainingSettings:
    """Return the settings of a network, as its folder keeps them."""
    from estimators.hybrid.training.settings import TrainingSettings

    record: Mapping[str, Any] = champion.fitted.record
    given = record.get("settings")
    known = {field.name for field in fields(TrainingSettings)}
    if not isinstance(given, dict) or not set(given) <= known:
        raise ModelStoreError(
            "the champion does not say how it was trained; say which kind to train, for example "
            "joint-physics"
        )
    try:
        values: dict[str, Any] = {**given, "without": tuple(given.get("without", ()))}
        return TrainingSettings(**values)
    except TypeError as error:
        raise ModelStoreError(f"the champion's training settings: {error}") from None
