from casadical.diagnosis.details import analyse as analyse
from casadical.diagnosis.result import Cause as Cause
from casadical.diagnosis.text import page_of as page_of
