"""What is measured."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Measurement:
    """The speed of one piece of work.

    Attributes:
        work: What was measured.
        value: The result, in `unit`.
        unit: The unit of both values.
        crowdnav: The same in CrowdNav's code, recorded once and not measured in this run; None where there is no such
            record.
    """

    work: str
    value: float
    unit: str
    crowdnav: float | None = None

    @property
    def ratio(self) -> float | None:
        """How many times less time crowdbench takes than CrowdNav's code."""
        return None if self.crowdnav is None else self.crowdnav / self.value


@dataclass(frozen=True)
class Variant:
    """A variant of the lookahead of SARL-SGAN-KCE.

    Attributes:
        name: What it does differently.
        seconds: Time for all its decisions, in seconds.
        changed_commands: Number of decisions in which its command differs from the first variant's.
        changed_outcomes: Number of episodes that end differently when it drives than when the first variant drives.
    """

    name: str
    seconds: float
    changed_commands: int
    changed_outcomes: int


@dataclass(frozen=True)
class VariantComparison:
    """Variants of the lookahead, compared on the same decisions.

    Attributes:
        variants: The variants. The first one is the reference: it has no speed-up that could change a command.
        decisions: Number of decisions that each variant made.
        episodes: Number of episodes that each variant drove.
    """

    variants: tuple[Variant, ...]
    decisions: int
    episodes: int
