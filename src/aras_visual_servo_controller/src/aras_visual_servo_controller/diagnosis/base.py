"""What every diagnosis is, their registry, and the order in which they are asked."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from aras_visual_servo_base.registry import Registry

from ..errors import ConfigurationError
from ..records.outcomes import Outcome
from ..records.run_record import ImageRecord
from .evidence import Evidence


class RunDiagnosis(ABC):
    """One thing that may be wrong with a run, or right.

    Attributes:
        name: under which it is registered. help: what it finds.
        reads: from what, and in which file, for the table in the README.
        kinds: of the outcomes that it finds by itself.
    """

    name: ClassVar[str] = ""
    help: ClassVar[str] = ""
    reads: ClassVar[str] = ""
    kinds: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Add one image to the evidence; its outcome, or None where the next diagnosis decides.

        It is not called where an earlier diagnosis of the order has found an outcome.
        """


DIAGNOSES = Registry(
    "diagnosis", f"{__package__}.diagnoses", (RunDiagnosis,), ConfigurationError
)
# An image is diagnosed in this order; the first outcome counts.
ORDER = (
    "scheme_failed",
    "stopped",
    "camera_retreat",
    "joints_do_not_follow",
    "target_lost",
    "wrong_object",
    "features_contradict",
    "target_moves",
    "wrong_camera_model",
    "converged",
    "not_converging",
)
