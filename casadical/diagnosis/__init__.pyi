from casadical.diagnosis.isolability import Isolability as Isolability
from casadical.diagnosis.json_answer import as_json as as_json
from casadical.diagnosis.localisation import Where as Where
from casadical.diagnosis.result import Cause as Cause
from casadical.diagnosis.result import Gap as Gap
from casadical.diagnosis.text import page_of as page_of
