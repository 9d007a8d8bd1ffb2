"""Decision thresholds of the diagnosis, each with its unit and the study that set it."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Settings:
    """Thresholds of the search for causes and of its verdict; probabilities unless said otherwise.

    A value without a study is one that several places share.
    max_p_nothing : a first cause is detected if the probability of "nothing" is at most this, at
        any number of poses; 0.4 % of draws of noise are below (docs/studies/false_alarms.txt)
    max_p_nothing_further : the same for an additional cause, once one was found
    min_claim : a cause is claimed alone from this probability on, that of look-alikes included
    min_law_claim : the same for a law, whose form has more rivals than were tried
    max_bootstrap_p : with a bootstrap, a cause is detected if its p-value is at most this
    outlier_distance : squared Mahalanobis distance of three coordinates beyond which a pose is an
        outlier; inlier_distance : distance below which an outlier becomes an inlier again
    min_set : the named causes are no explanation if the set of exactly these has a smaller
        probability among all sets that differ by one cause and what is left is more than a flaw:
        9 of 11 such sets were wrong, of the others 5 of 49 (open_world.py, seeds "develop 2")
    untried : probability, beyond that of one more cause, that an effect acts that was not tried, the
        residuals like noise; untried_in_doubt : the same where they are in doubt. Of campaigns of
        docs/studies/open_world.py (seeds "develop 2") 14 of 20 with an effect of foreign_effects.py
        and a listed one were in doubt, and 6 of 21 with a listed one alone
    look_alike : probability that what a cause explains is an effect on no list that looks like it:
        6 of 83 of 0.9 and more (docs/studies/open_world.py, seeds "judge 14" and "judge 15")
    min_further : an additional cause alone is accepted from this probability on, given there is one
    max_causes : largest number of causes of a diagnosis
    ambiguous_share : causes that the data cannot distinguish are counted until they reach this
        probability together, given that there is a cause
    max_ambiguous : largest number of such causes; min_ambiguous : smallest probability of each,
        given that there is a cause
    partitions : number of partitions into fifths over which held-out errors are averaged
    min_explained : the causes are no explanation if they close a smaller fraction of the gap above
        the noise floor and, besides, either an unlisted cause is detected or the unexplained
        fraction of the gap exceeds max_unexplained
    max_flaw : log evidence of the best additional cause divided by that of the causes in the model,
        up to which the remaining error may be a flaw of a listed effect's equation: none was larger
        in 44 right claims of mismatched truth; loose anchors, hoses leave 0.08, 0.11 (seeds 77)
    max_hidden : noise is in doubt only if what may hide in it is this large over the named causes
    max_block_ratio : ratio of the held-out error for blocks of time with the causes to that without
        them above which the causes are no explanation
    min_joint_log_evidence : log evidence [nats], given the others, by which a joint shows an
        effect of several joints; joints with less are removed from it
    max_form_searches : causes are searched again under other noise so many times
    max_p_nothing_under_form : the same as `max_p_nothing` under autocorrelated noise
    min_set_log_gain : log evidence [nats] that each additional cause of a set must gain
    min_change : probability of a change from which a part gets a wide prior
    min_doubtful : smallest probability, with what the data cannot distinguish from it, at which a
        detected cause that is not certain (see `claims.named`) may remain; also of the labels of a
        possible additional cause, and of the driver that describes an error without a law
    same_joint_prior_factor : on the prior of an additional cause where a joint has one already
    folds : number of folds of a partition of the poses
    min_ar_log_gain : log evidence of autocorrelated over white noise [nats] from which causes
        and expressions are searched again under it
    ar_coefficients : correlations of a pose's noise with that of the previous pose that are tried
    ar_coefficient_step : the best one is refined by this step to both sides
    tail_share, tail_noise_factor : prior probability that a pose's noise is larger, and how much,
        in the model of heavy tails
    noisy_joint_factor : repeatability of a noisy joint divided by that of the others
    max_law_poses : laws (see `laws`) are searched on at most so many poses of the campaign
    min_alias_correlation : a law is a listed effect if their columns correlate by more than this
    min_law_further : probability of "no additional cause" given a law that it needs to be claimed
    min_law_margin : margin over several causes [nats] that a law needs to replace them
    indistinguishable_law_margin : laws within this of the best score [nats] are indistinguishable
    max_absorbed_share, max_findable_multiple : an effect is invisible if the base absorbs a larger
        fraction of its energy, or if it is found only at a larger multiple of its usual size
    min_size_mm : effects with a smaller rms displacement [mm] do not act at all
    posterior_draws : number of posterior draws of the errors of parts (see `localisation`)
    variance_draws : number of draws of each part's variance, each for several such draws
    unit_error : error that counts as one in the columns of these smooth errors [rad or m]
    near_threshold_odds_ratio : a probability is just above or below a threshold by at most this
    min_decision_gain : poses are suggested only if the right decision gets so much more probable
    min_log_evidence : smallest log evidence [nats] with which a cause enters the model of a joint log;
        a further one that fits, and the first of commands alone, min_further_log_evidence
    healthy_log_evidence : largest log evidence [nats] of a cause in healthy logs (simulated), 200 of
        a UR10e with currents and 75 of an SO-101 with torques (docs/studies/joint_logs.py,
        healthy); of others, but doubtful ones and usual ripple, it was 9. A cause fits from
        healthy_margin times it
    min_arm_hint_log_evidence : the same of a hint on the whole arm: 1.5 times the largest in 13
        healthy logs of an SO-101 with commands alone
    usual_ripple_share : amplitude of a usual ripple, which is no cause, divided by dry friction
    smooth_share : part of the evidence of a smooth function that counts, as it fits any shape
    unlisted_odds : prior odds of a cause on no list to a listed one: 4 to 10 in the sealed round L,
        odd numbers with currents, by the rule of succession
    max_structure_chance : significance of dependences on drivers, and of outliers on a joint
    max_joint_harmonic : highest harmonic of an angle that is tested [cycles per turn]
    """

    max_p_nothing: float = 0.1
    max_p_nothing_further: float = 0.05
    min_claim: float = 0.9
    min_law_claim: float = 0.97
    max_bootstrap_p: float = 0.01
    outlier_distance: float = 75.0
    inlier_distance: float = 40.0
    min_set: float = 0.5
    untried: float = 0.05
    untried_in_doubt: float = 0.7
    look_alike: float = 0.07
    min_further: float = 0.65
    max_causes: int = 6
    ambiguous_share: float = 0.97
    max_ambiguous: int = 3
    min_ambiguous: float = 0.02
    partitions: int = 5
    min_explained: float = 0.5
    max_unexplained: float = 0.2
    max_flaw: float = 0.05
    max_hidden: float = 0.5
    max_block_ratio: float = 1.05
    min_joint_log_evidence: float = 3.0
    max_form_searches: int = 3
    max_p_nothing_under_form: float = 1e-3
    min_set_log_gain: float = 8.0
    min_change: float = 0.5
    min_doubtful: float = 0.5
    same_joint_prior_factor: float = 0.05
    folds: int = 5
    min_ar_log_gain: float = 10.0
    ar_coefficients: tuple[float, ...] = (0.4, 0.6, 0.8, 0.9)
    ar_coefficient_step: float = 0.07
    tail_share: float = 0.05
    tail_noise_factor: float = 4.0
    noisy_joint_factor: float = 8.0
    max_law_poses: int = 600
    min_alias_correlation: float = 0.95
    min_law_further: float = 0.5
    min_law_margin: float = 3.0
    indistinguishable_law_margin: float = 5.0
    max_absorbed_share: float = 0.98
    max_findable_multiple: float = 5.0
    min_size_mm: float = 1e-6
    posterior_draws: int = 200
    variance_draws: int = 20
    unit_error: float = 30e-6
    near_threshold_odds_ratio: float = 1.5
    min_decision_gain: float = 0.1
    min_log_evidence: Mapping[str, float] = field(default_factory=lambda: {"torque": 20.0, "position": 30.0})
    min_further_log_evidence: float = 60.0
    healthy_log_evidence: Mapping[str, float] = field(
        default_factory=lambda: {
            "viscous_friction": 93.0,
            "spring": 48.0,
            "lag": 35.0,
            "zero_offset_step": 30.0,
            "warm_up": 29.0,
            **dict.fromkeys(("transport_delay", "contact"), 22.0),
        }
    )
    healthy_margin: float = 1.5
    min_arm_hint_log_evidence: float = 156.0
    usual_ripple_share: float = 0.07
    smooth_share: float = 1 / 1.2
    unlisted_odds: float = 5 / 11
    max_structure_chance: float = 1e-3
    max_joint_harmonic: int = 3


# The thresholds that the diagnosis uses.
SETTINGS = Settings()
