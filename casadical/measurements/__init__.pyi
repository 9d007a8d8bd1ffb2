from casadical.measurements.columns import Columns as Columns
from casadical.measurements.derived_columns import derive as derive
