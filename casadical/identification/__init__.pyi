from casadical.identification.accuracy import errors as errors
from casadical.identification.accuracy import predicted as predicted
from casadical.identification.accuracy import residual_mm as residual_mm
