"""Decision thresholds of the diagnosis, each with its unit and the study that set it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Thresholds of the search for causes and of its verdict; probabilities unless said otherwise.

    max_p_nothing : something is there if "nothing" is less probable than this, however many poses
        there are: the noise is that of restricted likelihood. Of 30,000 draws of noise alone, 15 to
        200 poses (docs/studies/false_alarms.py with seeds 178), .4 % are below, .2 to .6 % at each
        number of poses.
    max_p_nothing_further : the same for a further cause, once one was found
    min_claim : a cause is claimed alone from this probability on: of claims, 98 in 100 are to be
        right, effects on no list included
    max_bootstrap_p : with a bootstrap, something is there if noise alone looks as much like it this
        often at most
    outlier_distance, inlier_distance : squared Mahalanobis distance of three coordinates beyond
        which a pose is an outlier, and below which it is none
    min_set : named causes are no explanation if exactly these are less probable than all sets that
        differ by one together, and the remainder is no mere flaw of an equation. Of 139 campaigns
        of docs/studies/open_world.py (seeds "develop 2") 9 of 11 such sets were wrong or
        incomplete; without the second condition 11 of 15; of those above 0.5 5 of 49.
    min_further : a further cause is accepted from this probability on, among those that are there
    max_causes : most causes of a diagnosis
    ambiguous_share, max_ambiguous, min_ambiguous : causes that the data cannot distinguish have
        this probability together, are at most so many, and none is less probable than the last
    partitions : of the poses into fifths, over which held-out errors are averaged
    min_explained, max_unexplained : explaining less than this share of what could be explained is
        no explanation, where something else is seen or more than the second share of the gap is
        left
    max_flaw : a flaw of a listed effect's equation leaves less than this share of its evidence: no
        such remainder was found in 44 right claims of mismatched truth; loose anchors and hoses
        leave 0.08 and 0.11 (seeds 77)
    max_block_ratio : causes with which blocks of time left out are predicted worse by this factor
        explain nothing
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
