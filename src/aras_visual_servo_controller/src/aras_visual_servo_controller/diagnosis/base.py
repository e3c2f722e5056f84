"""Base class of the diagnoses, their registry and their order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from aras_visual_servo_base.registry import Registry

from ..errors import ConfigurationError
from ..records.outcomes import Outcome
from ..records.run_record import ImageRecord
from ..records.state import PHASES
from .evidence import Evidence


class DiagnosisRule(ABC):
    """Detector of one possible fault of a run, or of its success.

    Attributes:
        name: name under which the diagnosis is registered.
        help: what the diagnosis detects.
        reads: data that the diagnosis uses, as text for the table in the README; it also names the
            module that evaluates them.
        kinds: kinds of the outcomes that the diagnosis reports.
        phases: phases of the loop in which `judge` is called.
    """

    name: ClassVar[str] = ""
    help: ClassVar[str] = ""
    reads: ClassVar[str] = ""
    kinds: ClassVar[tuple[str, ...]] = ()
    phases: ClassVar[tuple[str, ...]] = PHASES

    @abstractmethod
    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Add one image to the evidence; return an outcome, or None if there is no finding.

        The next diagnosis in the order is called only if this one returns None.
        """


DIAGNOSES = Registry(
    "diagnosis", f"{__package__}.diagnoses", (DiagnosisRule,), ConfigurationError
)
# Diagnoses in the order in which they process each image; the first outcome is reported.
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
