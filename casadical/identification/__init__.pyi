from casadical.identification.accuracy import Accuracy as Accuracy
from casadical.identification.accuracy import errors as errors
from casadical.identification.accuracy import predicted as predicted
from casadical.identification.accuracy import residual_mm as residual_mm
from casadical.identification.identifiability import Identifiability as Identifiability
from casadical.identification.identifiability import Unidentifiable as Unidentifiable
