"""Decision thresholds of the diagnosis."""

# Something is there if "nothing" is less probable than this, however many poses there are: the noise is that of
# restricted likelihood. Of 30,000 draws of noise alone, 15 to 200 poses (false_alarms.py with seeds 178), .4 % are
# below, .2 to .6 % at each number of poses.
DETECT = 0.1
# The same for a further cause, once one was found.
DETECT_FURTHER = 0.05
# A cause is claimed alone from this probability on: of claims, 98 in 100 are to be right, effects on no list included.
CLAIM = 0.97
# With a bootstrap: something is there if noise alone looks as much like it this often at most.
FALSE_ALARMS = 0.01
# Squared Mahalanobis distance of three coordinates beyond which a pose is an outlier, and below which it is none.
OUT, IN = 75.0, 40.0
# Named causes are no explanation if exactly these are less probable than all sets that differ by one together, and the
# remainder is no mere flaw of an equation (see MISMATCH). Of 139 campaigns of open_world.py (seeds "develop 2") 9 of 11
# such sets were wrong or incomplete; without the second condition 11 of 15; of those above 0.5 5 of 49.
SET_CLAIM = 0.5
# A further cause is accepted from this probability on, among those that are there.
LEAST_FURTHER = 0.65
MOST_CAUSES = 6
# Causes that these data cannot distinguish: together of this probability, at most so many, none below the last.
SET_SHARE, SET_SIZE, LEAST_ALIKE = 0.97, 3, 0.02
PARTITIONS = 5
# Less than this share of what could be explained is no explanation, where something else is seen or where more than
# the second share of the whole gap is left.
LEAST_SHARE, MUCH = 0.5, 0.2
# A flaw of a listed effect's equation leaves less than this share of its evidence: no such remainder was
# found in 44 right claims of mismatched truth; loose anchors and hoses leave 0.08 and 0.11 (docs/studies, seeds 77).
MISMATCH = 0.05
# Causes with which blocks of time left out are predicted worse by this factor explain nothing.
WORSE = 1.05
