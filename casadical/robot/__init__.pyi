from casadical.core.parameters import Parameter as Parameter
from casadical.core.parameters import Parameters as Parameters
