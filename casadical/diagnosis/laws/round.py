"""One comparison of laws with everything else, and when it claims a law.

A law is claimed if its score (see `search`) is 12 or more and 3 above that of the best listed effect, of the best form
on no list, and of noise that is not the model's. Where its columns are those of a listed effect, it is that effect
under another name. Laws that score nearly as much are named with it.
"""

from __future__ import annotations

from dataclasses import dataclass

from casadical.diagnosis.laws.problem import Scored

# Nats of a claim: of the score, and above rivals; of laws that are not distinguished.
CLAIMED, ABOVE, ALIKE = 12.0, 3.0, 5.0
MOST_ALIKE = 6


@dataclass(frozen=True, eq=False)
class Round:
    """One comparison of laws with everything else.

    laws : the most probable, the best first; listed, smooth : label and score of the best rivals, refined
    noise : the same of the best form of noise; alias : labels of listed effects whose columns are the best law's
    claimed : whether the best law is claimed
    """

    laws: tuple[Scored, ...]
    listed: tuple[str, float]
    smooth: tuple[str, float]
    noise: tuple[str, float]
    alias: tuple[str, ...]

    @property
    def best(self) -> Scored:
        """The most probable law."""
        return self.laws[0]

    @property
    def alike(self) -> tuple[Scored, ...]:
        """Laws that these data do not tell from the best one."""
        return tuple(s for s in self.laws[1:] if s.score > self.best.score - ALIKE)[:MOST_ALIKE]

    @property
    def claimed(self) -> bool:
        """Whether the best law is claimed."""
        return self.best.score >= CLAIMED and self.best.score >= self.rival[1] + ABOVE and not self.alias

    @property
    def rival(self) -> tuple[str, float]:
        """Label and score of the best of all rivals."""
        return max(self.listed, self.smooth, self.noise, key=lambda found: found[1])
