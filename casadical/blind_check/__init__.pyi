from casadical.blind_check.generation import make as make
from casadical.blind_check.own_robot import check_robot as check_robot
from casadical.blind_check.prediction import predict as predict
from casadical.blind_check.scoring import score as score
