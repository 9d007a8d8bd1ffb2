from casadical.export.c.kernel import load as load
from casadical.export.c.reference import Status as Status
from casadical.export.c.write import write_c as write_c
from casadical.export.controller.commands import Sources as Sources
from casadical.export.controller.commands import command_of as command_of
from casadical.export.controller.correction import model_corrector as model_corrector
from casadical.export.controller.inverse import inverse_kinematics as inverse_kinematics
from casadical.export.mjcf.replay import replay_campaign as replay_campaign
