"""Settings of a stage with its own table, in SI."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar


class PlannedStage(ABC):
    """Settings of a stage, from its table."""

    what: ClassVar[str]  # description of the stage, for progress and cost

    @property
    @abstractmethod
    def model_runs(self) -> int:
        """Number of model runs of the stage."""

    @property
    def identity(self) -> dict[str, Any]:
        """Inputs, by name, on which the stage's stored results depend; empty if the store checks them itself."""
        return {}
