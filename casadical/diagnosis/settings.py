"""Decision thresholds of the diagnosis, each with its unit and the study that set it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Thresholds of the search for causes and of its verdict; probabilities unless said otherwise.

    max_p_nothing : a first cause is detected if the probability of "nothing" is below this, at any
        number of poses, because the noise is that of restricted likelihood. Of 30,000 draws of pure
        noise at 15 to 200 poses (docs/studies/false_alarms.py with seeds 178), 0.4 % are below, 0.2
        to 0.6 % at each number of poses.
    max_p_nothing_further : the same for an additional cause, once one was found
    min_claim : a cause is claimed alone from this probability on; 98 of 100 claims are to be right,
        including campaigns with unlisted effects
    max_bootstrap_p : with a bootstrap, a cause is detected if its p-value is at most this
    outlier_distance : squared Mahalanobis distance of three coordinates beyond which a pose is an
        outlier; inlier_distance : distance below which an outlier becomes an inlier again
    min_set : the named causes are no explanation if the set of exactly these has a smaller
        probability among all sets that differ by one cause, and the remaining error is more than a
        flaw of an equation. Of 139 campaigns of docs/studies/open_world.py (seeds "develop 2") 9 of
        11 such sets were wrong or incomplete; without the second condition 11 of 15; of the sets
        above 0.5 5 of 49.
    min_further : an additional cause is accepted from this probability on, given that there is one
    max_causes : largest number of causes of a diagnosis
    ambiguous_share : probability of all causes together that the data cannot distinguish
    max_ambiguous : largest number of such causes; min_ambiguous : smallest probability of each
    partitions : number of partitions of the poses into fifths over which held-out errors are
        averaged
    min_explained : the causes are no explanation if they close a smaller share of the gap above the
        noise floor and an additional cause is detected, or the unexplained share of the gap exceeds
        max_unexplained
    max_flaw : evidence of the remaining error over that of the causes below which it may be a flaw
        of a listed effect's equation: none was larger in 44 right claims of mismatched truth; loose
        anchors and hoses leave 0.08 and 0.11 (seeds 77)
    max_block_ratio : ratio of the held-out error for blocks of time with the causes to that without
        them above which the causes are no explanation
    """

    max_p_nothing: float = 0.1
    max_p_nothing_further: float = 0.05
    min_claim: float = 0.97
    max_bootstrap_p: float = 0.01
    outlier_distance: float = 75.0
    inlier_distance: float = 40.0
    min_set: float = 0.5
    min_further: float = 0.65
    max_causes: int = 6
    ambiguous_share: float = 0.97
    max_ambiguous: int = 3
    min_ambiguous: float = 0.02
    partitions: int = 5
    min_explained: float = 0.5
    max_unexplained: float = 0.2
    max_flaw: float = 0.05
    max_block_ratio: float = 1.05


SETTINGS = Settings()
