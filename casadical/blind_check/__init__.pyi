from casadical.blind_check.making import make as make
from casadical.blind_check.predicting import predict as predict
from casadical.blind_check.scoring import score as score
