"""What a stage with a table of its own is to do, with everything in SI."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar


class PlannedStage(ABC):
    """Settings of a stage, made from its table."""

    what: ClassVar[str]  # the stage in words, for progress and cost

    @property
    @abstractmethod
    def model_runs(self) -> int:
        """Number of model runs that it takes."""

    @property
    def identity(self) -> dict[str, Any]:
        """What its stored work depends on, by name, where the store does not check that itself."""
        return {}
